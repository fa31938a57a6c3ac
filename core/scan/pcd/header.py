"""The header of a PCD file (Point Cloud Library, version 0.7)."""

from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from core.errors import ScanDamagedError

_MAX_HEADER_BYTES = 1 << 16
_MAX_RECORD_BYTES = 1 << 16
_SIZES = {"F": (4, 8), "U": (1, 2, 4, 8), "I": (1, 2, 4, 8)}
_PADDING = "_"


@dataclass(frozen=True)
class PcdField:
    """name: lower case. dtype: type of one value. count: values per point."""

    name: str
    dtype: np.dtype[Any]
    count: int


@dataclass(frozen=True)
class PcdHeader:
    """encoding: "ascii", "binary" or "binary_compressed". size_bytes, num_lines: where the data begins."""

    fields: tuple[PcdField, ...]
    num_points: int
    encoding: str
    size_bytes: int
    num_lines: int

    @property
    def num_values(self) -> int:
        """Return how many values a point has in ascii."""
        return sum(field.count for field in self.fields)

    @property
    def record_bytes(self) -> int:
        """Return the bytes of a point in binary."""
        return sum(field.dtype.itemsize * field.count for field in self.fields)

    def field(self, name: str) -> PcdField | None:
        """Return the field of that name, or None."""
        return next((field for field in self.fields if field.name == name), None)

    def record_dtype(self, is_ascii: bool) -> np.dtype[np.void]:
        """Return the type of one point; in ascii every value is float64."""
        fields: list[Any] = []
        for number, field in enumerate(self.fields):
            name = f"{_PADDING}{number}" if field.name == _PADDING else field.name
            dtype = np.dtype(np.float64) if is_ascii else field.dtype
            fields.append((name, dtype, (field.count,)) if field.count > 1 else (name, dtype))
        return np.dtype(fields)


def read_pcd_header(stream: BinaryIO) -> PcdHeader:
    """Parse the header at the start of `stream`; raise ScanDamagedError when it contradicts itself."""
    start = stream.read(_MAX_HEADER_BYTES)
    entries: dict[str, list[str]] = {}
    position = num_lines = 0
    while "DATA" not in entries:
        end = start.find(b"\n", position)
        if end < 0:
            raise _header_error("there is no DATA line")
        words = start[position:end].decode("ascii", errors="replace").split()
        position, num_lines = end + 1, num_lines + 1
        if words and not words[0].startswith("#"):
            if words[0].upper() in entries:
                raise _header_error(f"{words[0][:40]} stands twice")
            entries[words[0].upper()] = words[1:]
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise _header_error(f"DATA is {encoding[:40]!r}, expected ascii, binary or binary_compressed")
    return PcdHeader(_parse_fields(entries), _parse_num_points(entries), encoding, position, num_lines)


def _parse_fields(entries: dict[str, list[str]]) -> tuple[PcdField, ...]:
    names = [name.lower() for name in entries.get("FIELDS", entries.get("COLUMNS", []))]
    sizes, types = entries.get("SIZE", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise _header_error(
            f"FIELDS, SIZE, TYPE and COUNT have {len(names)}, {len(sizes)}, {len(types)} and {len(counts)} entries"
        )
    named = [name for name in names if name != _PADDING]
    if len(set(named)) < len(named):
        raise _header_error("a field is declared twice")
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        size_bytes, num_values = _parse_number(size, "SIZE"), _parse_number(count, "COUNT")
        if size_bytes not in _SIZES.get(kind.upper(), ()) or num_values < 1:
            raise _header_error(f"the field {name[:40]!r} has the type {kind[:8]}{size[:8]} and the count {num_values}")
        fields.append(PcdField(name, np.dtype(f"<{kind.lower()}{size_bytes}"), num_values))
    if sum(field.dtype.itemsize * field.count for field in fields) > _MAX_RECORD_BYTES:
        raise _header_error(f"a point takes more than {_MAX_RECORD_BYTES:,} bytes")
    return tuple(fields)


def _parse_num_points(entries: dict[str, list[str]]) -> int:
    width, height = (_parse_number("".join(entries.get(key, ["1"])), key) for key in ("WIDTH", "HEIGHT"))
    if "POINTS" not in entries:
        if "WIDTH" not in entries:
            raise _header_error("there is neither POINTS nor WIDTH")
        return width * height
    num_points = _parse_number("".join(entries["POINTS"]), "POINTS")
    if "WIDTH" in entries and num_points != width * height:
        raise _header_error(f"POINTS is {num_points:,}, but WIDTH x HEIGHT is {width:,} x {height:,}")
    return num_points


def _parse_number(word: str, key: str) -> int:
    if not (word.isdecimal() and word.isascii() and len(word) < 20):
        raise _header_error(f"{key} is {word[:40]!r}, expected a positive whole number")
    return int(word)


def _header_error(what: str) -> ScanDamagedError:
    return ScanDamagedError(f"The PCD header is damaged: {what}. Export the scan again.")
