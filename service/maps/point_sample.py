"""The stored sample of a map's points, cut to fewer points and written as PLY or JSON.

The points lie in an order in which every prefix is a fair sample (see `RegisterOutcome.points_ply`).
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

from panoloc.service.errors import StoredFileDamagedError

_COUNT = re.compile(rb"^element vertex (\d+)$", re.MULTILINE)
_CODES = {"float": "f", "double": "d", "uchar": "B"}
_END = b"end_header\n"
_MOST_HEADER_BYTES = 4096
_BLOCK_BYTES = 2**20


@dataclass(frozen=True)
class PlySample:
    """A binary little-endian PLY of x, y, z and red, green, blue, of which only the header is in memory.

    file: open, at the first point; reading the points closes it. point_format: of one point, as `struct` writes it.
    """

    header: bytes
    file: BinaryIO
    num_points: int
    point_format: str

    @classmethod
    def parse(cls, file: BinaryIO, key: str) -> "PlySample":
        """Read the header of a stored sample; key: for the message of StoredFileDamagedError."""
        header, end, _ = file.read(_MOST_HEADER_BYTES).partition(_END)
        declared = _COUNT.search(header)
        types = re.findall(rb"^property (\w+) \w+$", header, re.MULTILINE)
        codes = [_CODES.get(each.decode()) for each in types]
        if not end or declared is None or len(codes) != 6 or None in codes:
            file.close()
            raise StoredFileDamagedError(f"{key}: expected a PLY of coloured points, got something else; upload again")
        file.seek(len(header) + len(end))
        return cls(header + end, file, int(declared[1]), "<" + "".join(code for code in codes if code))

    def first(self, max_points: int) -> "PlySample":
        """Return a sample of at most `max_points` points, of the same file."""
        kept = min(self.num_points, max_points)
        header = _COUNT.sub(b"element vertex %d" % kept, self.header, count=1)
        return replace(self, header=header, num_points=kept)

    @property
    def num_bytes(self) -> int:
        """Return the size of the PLY file."""
        return len(self.header) + self._body_bytes

    def blocks(self) -> Iterator[bytes]:
        """Yield the PLY file, and close what it was read from."""
        with self.file as file:
            yield self.header
            left = self._body_bytes
            while left and (block := file.read(min(left, _BLOCK_BYTES))):
                left -= len(block)
                yield block

    def to_json(self) -> dict[str, Any]:
        """Return positions in metres and colours 0..255 as lists, and close the file."""
        with self.file as file:
            rows = list(struct.iter_unpack(self.point_format, file.read(self._body_bytes)))
        return {
            "num_points": self.num_points,
            "positions_m": [row[:3] for row in rows],
            "colors": [row[3:] for row in rows],
        }

    @property
    def _body_bytes(self) -> int:
        return self.num_points * struct.calcsize(self.point_format)
