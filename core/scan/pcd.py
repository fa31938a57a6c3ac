"""Read PCD scans of the Point Cloud Library 0.7: ascii, binary, binary_compressed; packed or separate colours."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error, stack_columns
from panoloc.core.scan.text.table import TextLines

_MAX_HEADER_BYTES = 1 << 16
_MAX_RECORD_BYTES = 1 << 16
# The decompressed file is held in memory as a whole: its columns lie one behind the other.
_MAX_DECOMPRESSED_BYTES = 2 << 30
# One three-byte reference of LZF yields at most this many bytes: more is a bomb or damage.
_MAX_RATIO = 88
_LITERAL_LIMIT, _LONG_LENGTH = 32, 7
_SIZES = {"F": (4, 8), "U": (1, 2, 4, 8), "I": (1, 2, 4, 8)}
_POSITION_NAMES = ("x", "y", "z")
_PACKED_NAMES = (("rgb",), ("rgba",))
_SEPARATE_NAMES = (("r", "g", "b"), ("red", "green", "blue"))


@dataclass(frozen=True)
class _Header:
    """dtype: of one point, packed. encoding: a key of _ITERATORS. size_bytes, num_lines: where the data begins."""

    dtype: np.dtype[np.void]
    num_points: int
    encoding: str
    size_bytes: int
    num_lines: int

    @property
    def kinds(self) -> dict[str, np.dtype[Any]]:
        """Return the types of all fields, in their order."""
        return {name: self.dtype[name] for name in self.dtype.names or ()}


def read_pcd(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a PCD file in chunks.

    Raises ScanDamagedError when the file is shorter than its header says, ScanContentError without coordinates or
    colour.
    """
    with context.path.open("rb") as stream:
        header = _read_header(stream)
        context.check_point_count(header.num_points)
        colors = _color_names(header)
        stream.seek(header.size_bytes)
        num_done = 0
        for rows in _ITERATORS[header.encoding](stream, header, context.size_bytes):
            num_done += len(rows)
            positions = stack_columns(rows, _POSITION_NAMES, np.float64)
            yield RawChunk(positions, _convert_colors(rows, header, colors), num_done / header.num_points)


def _read_header(stream: BinaryIO) -> _Header:
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
    if encoding not in _ITERATORS:
        raise _header_error(f"DATA is {encoding[:40]!r}, expected {', '.join(_ITERATORS)}")
    return _Header(_parse_fields(entries), _parse_num_points(entries), encoding, position, num_lines)


def _parse_fields(entries: dict[str, list[str]]) -> np.dtype[np.void]:
    names = [name.lower() for name in entries.get("FIELDS", entries.get("COLUMNS", []))]
    sizes, types = entries.get("SIZE", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise _header_error(
            f"FIELDS, SIZE, TYPE and COUNT have {len(names)}, {len(sizes)}, {len(types)} and {len(counts)} entries"
        )
    fields: dict[str, Any] = {}
    num_bytes = 0
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        size_bytes, num_values = _parse_number(size, "SIZE"), _parse_number(count, "COUNT")
        if size_bytes not in _SIZES.get(kind.upper(), ()) or num_values < 1:
            raise _header_error(f"the field {name[:40]!r} has the type {kind[:8]}{size[:8]} and the count {num_values}")
        if name in fields:
            raise _header_error(f"the field {name[:40]!r} is declared twice")
        num_bytes += size_bytes * num_values
        if num_bytes > _MAX_RECORD_BYTES:
            raise _header_error(f"a point takes more than {_MAX_RECORD_BYTES:,} bytes")
        dtype = f"<{kind.lower()}{size_bytes}"
        # Padding is called "_", as often as there is some.
        fields[f"_{number}" if name == "_" else name] = (dtype, (num_values,)) if num_values > 1 else (dtype,)
    return np.dtype([(name, *kind) for name, kind in fields.items()])


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


def _color_names(header: _Header) -> tuple[str, ...]:
    """Return the names of red, green and blue, or of the one field that packs them. Raises ScanContentError without."""
    kinds = {name: kind for name, kind in header.kinds.items() if not kind.shape}
    names = ", ".join(header.kinds)[:200]
    if not kinds.keys() >= set(_POSITION_NAMES):
        raise ScanContentError(f"The PCD file has no x, y and z; its fields are {names}.")
    if any(name in kinds and kinds[name].itemsize != 4 for (name,) in _PACKED_NAMES):
        raise ScanDamagedError("The PCD header is damaged: packed colours must have the size 4. Export the scan again.")
    found = next((each for each in (*_SEPARATE_NAMES, *_PACKED_NAMES) if kinds.keys() >= set(each)), None)
    if found is None:
        raise no_color_error(names)
    return found


def _iter_ascii(stream: BinaryIO, header: _Header, size_bytes: int) -> Iterator[NDArray[np.void]]:
    dtype = np.dtype([(name, np.float64, kind.shape) for name, kind in header.kinds.items()])
    lines = TextLines(stream, first_line=header.num_lines + 1)
    for block in lines.iter_rows(header.num_points, "The PCD header", "points"):
        yield block.to_table(dtype.itemsize // 8).view(dtype)[:, 0]


def _iter_binary(stream: BinaryIO, header: _Header, size_bytes: int) -> Iterator[NDArray[np.void]]:
    per_point, available = header.dtype.itemsize, size_bytes - header.size_bytes
    if header.num_points * per_point > available:
        raise ScanDamagedError(
            f"The PCD header announces {header.num_points:,} points of {per_point:,} bytes, but the file holds "
            f"{available:,} bytes, enough for {available // per_point:,}. {CUT_SHORT}"
        )
    for start in range(0, header.num_points, CHUNK_ROWS):
        num_rows = min(CHUNK_ROWS, header.num_points - start)
        yield np.frombuffer(stream.read(num_rows * per_point), header.dtype, num_rows)


def _iter_compressed(stream: BinaryIO, header: _Header, size_bytes: int) -> Iterator[NDArray[np.void]]:
    data = _decompress(stream, header, size_bytes)
    columns: dict[str, NDArray[Any]] = {}
    offset = 0
    for name, kind in header.kinds.items():
        columns[name] = np.ndarray((header.num_points, *kind.shape), kind.base, data, offset)
        offset += header.num_points * kind.itemsize
    for start in range(0, header.num_points, CHUNK_ROWS):
        rows = np.empty(min(CHUNK_ROWS, header.num_points - start), header.dtype)
        for name, column in columns.items():
            rows[name] = column[start : start + len(rows)]
        yield rows


_ITERATORS = {"ascii": _iter_ascii, "binary": _iter_binary, "binary_compressed": _iter_compressed}


def _decompress(stream: BinaryIO, header: _Header, size_bytes: int) -> bytes:
    num_compressed, num_bytes = struct.unpack("<II", stream.read(8).ljust(8, b"\0"))
    expected = header.num_points * header.dtype.itemsize
    compressed = stream.read(min(num_compressed, size_bytes))
    if num_bytes != expected or num_bytes > max(num_compressed, 1) * _MAX_RATIO or len(compressed) < num_compressed:
        raise ScanDamagedError(
            f"The PCD header announces {header.num_points:,} points ({expected:,} bytes), but its compressed data announces "
            f"{num_bytes:,} in {num_compressed:,} bytes, of which the file holds {len(compressed):,}. {CUT_SHORT}"
        )
    if num_bytes > _MAX_DECOMPRESSED_BYTES:
        raise ScanContentError(
            f"The compressed PCD data unpacks to {num_bytes:,} bytes; at most {_MAX_DECOMPRESSED_BYTES:,} are unpacked "
            "in memory. Save it as binary (not binary_compressed), or as PLY or LAZ."
        )
    try:
        return decompress_lzf(compressed, num_bytes)
    except ValueError as error:
        raise ScanDamagedError(f"The compressed PCD data is damaged: {error}. Export the scan again.") from error


def _convert_colors(rows: NDArray[np.void], header: _Header, names: tuple[str, ...]) -> NDArray[Any]:
    stored = rows.dtype[names[0]]
    if len(names) == 1:
        return _unpack_colors(rows[names[0]], header.dtype[names[0]])
    is_whole = stored.kind == "u" and stored.itemsize <= 2
    return stack_columns(rows, names, stored.newbyteorder("=") if is_whole else np.float64)


def _unpack_colors(packed: NDArray[Any], declared: np.dtype[Any]) -> NDArray[Any]:
    """Return (n, 3) uint8, or float64 with NaN rows for colours that text could not carry."""
    if packed.dtype.itemsize == 4:  # binary: the four bytes themselves
        return _split_words(np.ascontiguousarray(packed).view(np.uint32))
    with np.errstate(invalid="ignore", over="ignore"):
        words = np.nan_to_num(packed, nan=0.0, posinf=0.0, neginf=0.0)
        if declared.kind == "f":
            # Text holds either the float whose bits are the colour, or (since whole numbers survive printing) the
            # number itself; floats from 1 on would be colours with an alpha that nobody writes.
            bits = words.astype(np.float32).view(np.uint32)
            is_number = (words >= 1) & (words < 1 << 24)
            words = np.where(is_number, np.rint(words), bits)
        whole = (words % (1 << 32)).astype(np.uint32)
    colors = _split_words(whole).astype(np.float64)
    colors[~np.isfinite(packed)] = np.nan
    return colors


def _split_words(words: NDArray[np.uint32]) -> NDArray[np.uint8]:
    return np.stack([words >> 16, words >> 8, words], axis=1).astype(np.uint8)


def decompress_lzf(data: bytes, num_bytes: int) -> bytes:
    """Return the `num_bytes` bytes that `data`, packed by liblzf, decompresses to; raise ValueError when it does not.

    A byte below 32 announces that many literal bytes plus one; any other begins a reference: three bits of length
    (seven: one more length byte follows) and thirteen bits of distance into what is already there.
    """
    output = bytearray()
    position, end = 0, len(data)
    try:
        while position < end:
            control = data[position]
            position += 1
            if control < _LITERAL_LIMIT:
                output += data[position : position + control + 1]
                position += control + 1
                continue
            length = control >> 5
            if length == _LONG_LENGTH:
                length += data[position]
                position += 1
            start = len(output) - ((control & 0x1F) << 8) - data[position] - 1
            position += 1
            _repeat(output, start, length + 2)
            if len(output) > num_bytes:
                break
    except IndexError:
        raise ValueError("the compressed data ends in the middle of a reference") from None
    if len(output) != num_bytes or position != end:
        raise ValueError(f"the compressed data gives {len(output):,} bytes, expected {num_bytes:,}")
    return bytes(output)


def _repeat(output: bytearray, start: int, length: int) -> None:
    if start < 0:
        raise ValueError("the compressed data refers to bytes before its beginning")
    piece = output[start : start + length]
    if len(piece) < length:  # the reference overlaps what it writes: the piece repeats itself
        piece = (piece * (length // len(piece) + 1))[:length]
    output += piece
