"""The stored sample of a map's points, cut to fewer points and written as PLY or JSON.

The points lie in an order in which every prefix is a fair sample (see `RegisterOutcome.points_ply`).
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import numpy as np

from panoloc.service.errors import StoredFileDamagedError

_COUNT = re.compile(rb"^element vertex (\d+)$", re.MULTILINE)
_PROPERTIES = re.compile(rb"(?:property (float|double) [xyz]\n){3}(?:property uchar \w+\n){3}$")
_END = b"end_header\n"
_MOST_HEADER_BYTES = 4096
_BLOCK_BYTES = 2**20


@dataclass(frozen=True)
class PlySample:
    """A binary little-endian PLY of x, y, z and red, green, blue, of which only the header is in memory.

    file: open, at the first point; reading the points closes it. point: how one is stored.
    """

    header: bytes
    file: BinaryIO
    num_points: int
    point: np.dtype[Any]

    @classmethod
    def parse(cls, file: BinaryIO, key: str) -> "PlySample":
        """Read the header of a stored sample; key: for the message of StoredFileDamagedError."""
        header, end, _ = file.read(_MOST_HEADER_BYTES).partition(_END)
        declared, properties = _COUNT.search(header), _PROPERTIES.search(header)
        if not end or declared is None or properties is None:
            file.close()
            raise StoredFileDamagedError(f"{key}: expected a PLY of coloured points, got something else; upload again")
        file.seek(len(header) + len(end))
        scalar = "<f4" if properties[1] == b"float" else "<f8"
        return cls(header + end, file, int(declared[1]), np.dtype([("position", scalar, 3), ("color", "u1", 3)]))

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
            rows = np.frombuffer(file.read(self._body_bytes), self.point)
        return {
            "num_points": self.num_points,
            "positions_m": rows["position"].tolist(),
            "colors": rows["color"].tolist(),
        }

    @property
    def _body_bytes(self) -> int:
        return self.num_points * self.point.itemsize
