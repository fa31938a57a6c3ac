"""The data of a PLY file, ascii or binary, element by element, in bounded batches."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError
from panoloc.core.scan.ply.header import PlyElement, PlyHeader
from panoloc.core.scan.reading_context import CHUNK_ROWS, stack_columns
from panoloc.core.scan.text.table import TextBlock, TextLines

_BLOCK_BYTES = 1 << 23
_MAX_ROW_BYTES = 1 << 24
_NUMBER = "<f8"  # of every value of an ascii file


@dataclass(frozen=True)
class RowBatch:
    """Rows whose lists have equal lengths: `records` has one field per property, lists as (n, length) fields.

    rows: (n,) which rows of the element these are.
    """

    rows: NDArray[np.int64]
    records: NDArray[np.void]


class PlyBody:
    """Reads the elements of `header` in the order of the file. Raises ScanDamagedError for rows that do not fit it."""

    def __init__(self, stream: BinaryIO, header: PlyHeader):
        stream.seek(header.size_bytes)
        self._stream = stream
        self._lines = TextLines(stream, header.num_lines + 1) if header.is_ascii else None

    def skip(self, element: PlyElement) -> None:
        """Move behind `element`."""
        if self._lines is None and not element.has_lists:
            self._stream.seek(element.count * _record_dtype(element, ()).itemsize, 1)
            return
        for _ in self.iter_rows(element) if self._lines is None else _iter_lines(self._lines, element):
            pass

    def iter_rows(self, element: PlyElement) -> Iterator[list[RowBatch]]:
        """Yield the rows of an element block by block; the batches of a block hold its rows in any order."""
        if self._lines is not None:
            return _iter_text_rows(self._lines, element)
        return _iter_binary_lists(self._stream, element) if element.has_lists else _iter_records(self._stream, element)

    def iter_scalars(self, element: PlyElement, names: Sequence[str]) -> Iterator[NDArray[np.void]]:
        """Yield structured arrays of the scalar properties `names`, in the order of the file."""
        for batches in self.iter_rows(element):
            rows = np.concatenate([batch.rows for batch in batches])
            yield np.concatenate([batch.records[list(names)] for batch in batches])[np.argsort(rows)]


def convert_colors(rows: NDArray[np.void], element: PlyElement, names: tuple[str, str, str]) -> NDArray[Any]:
    """Return the raw colours of `rows`, (n, 3) in a type that tells their range apart (see RawChunk)."""
    declared = element.scalars[names[0]]
    num_bytes = int(declared[2])
    if declared[1] == "f" or num_bytes > 2:
        return stack_columns(rows, names, np.float64)
    # Some programs call their colour bytes "char" or "short"; nobody means negative colours.
    unsigned = np.dtype(f"u{num_bytes}")
    if rows.dtype[names[0]].kind != "f":
        return stack_columns(rows, names, unsigned)
    values = stack_columns(rows, names, np.float64)
    if not np.array_equal(values, np.clip(np.rint(values), 0, np.iinfo(unsigned).max)):
        raise ScanDamagedError(
            f"The PLY header declares colours as whole numbers of {num_bytes * 8} bits, but the data holds "
            f"values from {np.nanmin(values):g} to {np.nanmax(values):g}. Export the scan again."
        )
    return values.astype(unsigned)


def _iter_lines(lines: TextLines, element: PlyElement) -> Iterator[TextBlock]:
    count = element.count if element.properties else 0
    return lines.iter_rows(count, "The PLY header", f"rows of {element.name!r}")


def _iter_text_rows(lines: TextLines, element: PlyElement) -> Iterator[list[RowBatch]]:
    numbers = [replace(prop, type=_NUMBER, count_type=prop.count_type and _NUMBER) for prop in element.properties]
    element = replace(element, properties=tuple(numbers))
    first_row = 0
    for block in _iter_lines(lines, element):
        if element.has_lists:
            yield list(_parse_lists(block, element, first_row))
        else:
            records = block.to_table(len(numbers)).view(_record_dtype(element, ()))[:, 0]
            yield [RowBatch(np.arange(len(records)), records)]
        first_row += len(block)


def _parse_lists(block: TextBlock, element: PlyElement, first_row: int) -> Iterator[RowBatch]:
    data = block.to_values().tobytes()
    offsets, lengths, end = _walk_rows(data, element, len(block))
    # Every row has to begin and end where its line does.
    found = np.append(offsets, end)
    expected = np.concatenate([[0], np.cumsum(block.num_values) * np.dtype(_NUMBER).itemsize])
    wrong = np.flatnonzero(found != expected[: len(found)])
    if len(wrong) or len(offsets) < len(block):
        row = int(wrong[0]) - 1 if len(wrong) else len(offsets)
        raise ScanDamagedError(
            f"Line {block.numbers[row]:,} does not fit the lists of the PLY element {element.name!r}: "
            f"{block.excerpt(row)}. The file is damaged; export the scan again."
        )
    return _gather_batches(data, element, first_row, offsets, lengths)


def _iter_records(stream: BinaryIO, element: PlyElement) -> Iterator[list[RowBatch]]:
    dtype = _record_dtype(element, ())
    for start in range(0, element.count, CHUNK_ROWS):
        num_rows = min(CHUNK_ROWS, element.count - start)
        data = stream.read(num_rows * dtype.itemsize)
        if len(data) < num_rows * dtype.itemsize:
            raise _cut_short_error(element, start + len(data) // dtype.itemsize)
        yield [RowBatch(np.arange(num_rows), np.frombuffer(data, dtype))]


def _iter_binary_lists(stream: BinaryIO, element: PlyElement) -> Iterator[list[RowBatch]]:
    num_done, data = 0, b""
    wanted = _BLOCK_BYTES
    while num_done < element.count:
        more = stream.read(max(wanted - len(data), 0))
        data += more
        offsets, lengths, end = _walk_rows(data, element, element.count - num_done)
        if offsets:
            yield list(_gather_batches(data, element, num_done, offsets, lengths))
            num_done += len(offsets)
            data, wanted = data[end:], _BLOCK_BYTES
        elif not more:
            raise _cut_short_error(element, num_done)
        elif len(data) >= _MAX_ROW_BYTES:
            raise ScanDamagedError(
                f"Row {num_done} of the PLY element {element.name!r} holds a list of impossible length. {CUT_SHORT}"
            )
        else:
            wanted = len(data) * 2
    stream.seek(-len(data), 1)


def _cut_short_error(element: PlyElement, num_found: int) -> ScanDamagedError:
    return ScanDamagedError(
        f"The PLY header announces {element.count:,} rows of {element.name!r}, but the file ends after "
        f"{num_found:,}. {CUT_SHORT}"
    )


def _record_dtype(element: PlyElement, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    fields: list[Any] = []
    remaining = iter(lengths)
    for prop in element.properties:
        if prop.count_type is None:
            fields.append((prop.name, prop.type))
        else:
            fields += [(f"{prop.name} length", prop.count_type), (prop.name, prop.type, (next(remaining),))]
    return np.dtype(fields)


def _walk_rows(data: bytes, element: PlyElement, max_rows: int) -> tuple[list[int], list[tuple[int, ...]], int]:
    """Return where whole rows begin in `data`, the lengths of their lists, and where the last one ends.

    Stops before a row that is not complete, or has a list of an impossible length.
    """
    steps, skip = [], 0  # of each list: bytes to skip, then how to read its length, then the size of its items
    for prop in element.properties:
        if prop.count_type is None:
            skip += prop.min_bytes
        else:
            length_format = prop.count_type[0] + np.dtype(prop.count_type).char
            steps.append((skip, struct.Struct(length_format), int(prop.type[2])))
            skip = 0
    offsets: list[int] = []
    lengths: list[tuple[int, ...]] = []
    position, size = 0, len(data)
    while len(offsets) < max_rows:
        cursor, row_lengths = position, []
        for before, read_length, item_size in steps:
            cursor += before
            if cursor + read_length.size > size:
                return offsets, lengths, position
            (length,) = read_length.unpack_from(data, cursor)
            if not 0 <= length <= size or length != int(length):
                return offsets, lengths, position
            row_lengths.append(int(length))
            cursor += read_length.size + int(length) * item_size
        cursor += skip
        if cursor > size:
            break
        offsets.append(position)
        lengths.append(tuple(row_lengths))
        position = cursor
    return offsets, lengths, position


def _gather_batches(
    data: bytes, element: PlyElement, first_row: int, offsets: list[int], lengths: list[tuple[int, ...]]
) -> Iterator[RowBatch]:
    codes = np.frombuffer(data, np.uint8)
    starts = np.array(offsets)
    distinct = {row_lengths: number for number, row_lengths in enumerate(dict.fromkeys(lengths))}
    groups = np.array([distinct[row_lengths] for row_lengths in lengths])
    for row_lengths, number in distinct.items():
        dtype = _record_dtype(element, row_lengths)
        rows = np.flatnonzero(groups == number)
        row_bytes = codes[starts[rows][:, None] + np.arange(dtype.itemsize)]
        yield RowBatch(rows + first_row, np.ascontiguousarray(row_bytes).view(dtype)[:, 0])
