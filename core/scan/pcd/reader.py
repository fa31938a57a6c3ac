"""Read PCD scans: ascii, binary and binary_compressed, with packed or separate colours."""

import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from core.scan.pcd.header import PcdHeader, read_pcd_header
from core.scan.pcd.lzf import MAX_RATIO, decompress_lzf
from core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error, stack_columns
from core.scan.text.table import TextLines

# The decompressed file is held in memory as a whole: its columns lie one behind the other.
_MAX_DECOMPRESSED_BYTES = 2 << 30
_PACKED_NAMES = ("rgb", "rgba")
_SEPARATE_NAMES = (("r", "g", "b"), ("red", "green", "blue"))
_POSITION_NAMES = ("x", "y", "z")


def read_pcd(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a PCD file in chunks.

    Raises ScanDamagedError when the file is shorter than its header says, ScanContentError without coordinates or
    colour.
    """
    with context.path.open("rb") as stream:
        header = read_pcd_header(stream)
        context.check_point_count(header.num_points)
        _check_fields(header)
        _check_size(header, context.size_bytes)
        stream.seek(header.size_bytes)
        num_done = 0
        for rows in _iter_rows(stream, header):
            num_done += len(rows)
            positions = stack_columns(rows, _POSITION_NAMES, np.float64)
            yield RawChunk(positions, _convert_colors(rows, header), num_done / header.num_points)


def _check_fields(header: PcdHeader) -> None:
    single = {field.name for field in header.fields if field.count == 1}
    names = ", ".join(field.name for field in header.fields)[:200]
    if not single.issuperset(_POSITION_NAMES):
        raise ScanContentError(f"The PCD file has no x, y and z; its fields are {names}.")
    packed = [header.field(name) for name in _PACKED_NAMES if name in single]
    if not any(single.issuperset(separate) for separate in _SEPARATE_NAMES) and not packed:
        raise no_color_error(names)
    if any(field and field.dtype.itemsize != 4 for field in packed):
        raise ScanDamagedError("The PCD header is damaged: packed colours must have the size 4. Export the scan again.")


def _check_size(header: PcdHeader, size_bytes: int) -> None:
    available = size_bytes - header.size_bytes
    per_point = header.record_bytes if header.encoding == "binary" else 2 * header.num_values
    needed = header.num_points * per_point - (header.encoding == "ascii")
    if header.encoding != "binary_compressed" and needed > available:
        raise ScanDamagedError(
            f"The PCD header announces {header.num_points:,} points (at least {needed:,} bytes of data), but the file "
            f"holds {available:,} bytes, enough for {available // per_point:,}. {CUT_SHORT}"
        )


def _iter_rows(stream: BinaryIO, header: PcdHeader) -> Iterator[NDArray[np.void]]:
    if header.encoding == "ascii":
        return _iter_ascii(stream, header)
    if header.encoding == "binary":
        return _iter_binary(stream, header)
    return _iter_compressed(stream, header)


def _iter_ascii(stream: BinaryIO, header: PcdHeader) -> Iterator[NDArray[np.void]]:
    lines = TextLines(stream, first_line=header.num_lines + 1)
    dtype = header.record_dtype(is_ascii=True)
    num_done = 0
    while num_done < header.num_points:
        block = lines.take(min(CHUNK_ROWS, header.num_points - num_done))
        if block is None:
            raise ScanDamagedError(
                f"The PCD header announces {header.num_points:,} points, but the file ends after {num_done:,}. "
                f"{CUT_SHORT}"
            )
        num_done += len(block)
        yield block.to_table(header.num_values).view(dtype)[:, 0]


def _iter_binary(stream: BinaryIO, header: PcdHeader) -> Iterator[NDArray[np.void]]:
    dtype = header.record_dtype(is_ascii=False)
    for start in range(0, header.num_points, CHUNK_ROWS):
        num_rows = min(CHUNK_ROWS, header.num_points - start)
        yield np.frombuffer(stream.read(num_rows * dtype.itemsize), dtype, num_rows)


def _iter_compressed(stream: BinaryIO, header: PcdHeader) -> Iterator[NDArray[np.void]]:
    data = _decompress(stream, header)
    columns: dict[str, NDArray[Any]] = {}
    dtype = header.record_dtype(is_ascii=False)
    offset = 0
    for field, name in zip(header.fields, dtype.names or (), strict=True):
        column = np.frombuffer(data, field.dtype, header.num_points * field.count, offset)
        columns[name] = column.reshape(header.num_points, field.count) if field.count > 1 else column
        offset += column.nbytes
    for start in range(0, header.num_points, CHUNK_ROWS):
        rows = np.empty(min(CHUNK_ROWS, header.num_points - start), dtype)
        for name, column in columns.items():
            rows[name] = column[start : start + len(rows)]
        yield rows


def _decompress(stream: BinaryIO, header: PcdHeader) -> bytes:
    sizes = stream.read(8)
    if len(sizes) < 8:
        raise ScanDamagedError(f"The PCD file ends before its compressed data. {CUT_SHORT}")
    num_compressed, num_bytes = struct.unpack("<II", sizes)
    expected = header.num_points * header.record_bytes
    if num_bytes > max(num_compressed, 1) * MAX_RATIO:
        raise ScanDamagedError(
            f"The compressed data of the PCD file ({num_compressed:,} bytes) announces {num_bytes:,} bytes, which so few cannot hold. "
            "Export the scan again."
        )
    if num_bytes != expected:
        raise ScanDamagedError(
            f"The PCD header announces {header.num_points:,} points ({expected:,} bytes), but its compressed data "
            f"({num_compressed:,} bytes) announces {num_bytes:,}. Export the scan again."
        )
    if num_bytes > _MAX_DECOMPRESSED_BYTES:
        raise ScanContentError(
            f"The compressed PCD data unpacks to {num_bytes:,} bytes; at most {_MAX_DECOMPRESSED_BYTES:,} are unpacked "
            "in memory. Save it as binary (not binary_compressed), or as PLY or LAZ."
        )
    compressed = stream.read(num_compressed)
    if len(compressed) < num_compressed:
        raise ScanDamagedError(
            f"The PCD file announces {num_compressed:,} bytes of compressed data, but holds {len(compressed):,}. "
            f"{CUT_SHORT}"
        )
    try:
        return decompress_lzf(compressed, num_bytes)
    except ValueError as error:
        raise ScanDamagedError(f"The compressed PCD data is damaged: {error}. Export the scan again.") from error


def _convert_colors(rows: NDArray[np.void], header: PcdHeader) -> NDArray[Any]:
    for names in _SEPARATE_NAMES:
        first = header.field(names[0])
        if first is not None and all(header.field(name) for name in names):
            is_whole = header.encoding != "ascii" and first.dtype.kind == "u" and first.dtype.itemsize <= 2
            return stack_columns(rows, names, first.dtype.newbyteorder("=") if is_whole else np.float64)
    packed = next(field for field in header.fields if field.name in _PACKED_NAMES)
    return _unpack_colors(rows[packed.name], packed.dtype)


def _unpack_colors(packed: NDArray[Any], declared: np.dtype[Any]) -> NDArray[Any]:
    """Return (n, 3) uint8, or float64 with NaN rows for colours that text could not carry."""
    if packed.dtype.kind != "f" or packed.dtype.itemsize == 4:  # binary: the four bytes themselves
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
