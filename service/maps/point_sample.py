"""The stored sample of a map's points, cut to fewer points and written as PLY or JSON.

The points lie in an order in which every prefix is a fair sample (see `RegisterOutcome.points_ply`).
"""

import re
import struct
from dataclasses import dataclass
from typing import Any

from service.errors import StoredFileDamagedError

_COUNT = re.compile(rb"^element vertex (\d+)$", re.MULTILINE)
_CODES = {"float": "f", "double": "d", "uchar": "B"}
_END = b"end_header\n"


@dataclass(frozen=True)
class PlySample:
    """A binary little-endian PLY of x, y, z and red, green, blue, in this order."""

    header: bytes
    body: bytes
    num_points: int
    point_format: str

    @classmethod
    def parse(cls, data: bytes, key: str) -> "PlySample":
        """Read a stored sample; key: for the message of StoredFileDamagedError."""
        header, end, body = data.partition(_END)
        declared = _COUNT.search(header)
        types = re.findall(rb"^property (\w+) \w+$", header, re.MULTILINE)
        codes = [_CODES.get(each.decode()) for each in types]
        if not end or declared is None or len(codes) != 6 or None in codes:
            raise StoredFileDamagedError(f"{key}: expected a PLY of coloured points, got something else; upload again")
        return cls(header + end, body, int(declared[1]), "<" + "".join(code for code in codes if code))

    def first(self, max_points: int) -> "PlySample":
        """Return a sample of at most `max_points` points."""
        kept = min(self.num_points, max_points)
        header = _COUNT.sub(b"element vertex %d" % kept, self.header, count=1)
        return PlySample(header, self.body[: kept * struct.calcsize(self.point_format)], kept, self.point_format)

    def to_ply(self) -> bytes:
        """Return the PLY file."""
        return self.header + self.body

    def to_json(self) -> dict[str, Any]:
        """Return positions in metres and colours 0..255 as lists."""
        rows = list(struct.iter_unpack(self.point_format, self.body))
        return {
            "num_points": self.num_points,
            "positions_m": [row[:3] for row in rows],
            "colors": [row[3:] for row in rows],
        }
