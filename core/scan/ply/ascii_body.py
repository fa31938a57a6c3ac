"""Rows of ascii PLY elements in bounded batches, in the same form as `ply_binary` gives them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanDamagedError
from core.scan.ply.binary_body import RowBatch, cut_short_error
from core.scan.ply.header import PlyElement
from core.scan.text.table import TextBlock, TextLines


def iter_plain_rows(lines: TextLines, element: PlyElement, batch_rows: int) -> Iterator[NDArray[np.void]]:
    """Yield the rows of an element without lists as structured arrays of float64 fields."""
    dtype = np.dtype([(prop.name, np.float64) for prop in element.properties])
    for block in _iter_blocks(lines, element, batch_rows):
        yield block.to_table(len(element.properties)).view(dtype)[:, 0]


def iter_list_rows(lines: TextLines, element: PlyElement, batch_rows: int) -> Iterator[list[RowBatch]]:
    """Yield the rows of an element with lists; all fields are float64."""
    first_row = 0
    for block in _iter_blocks(lines, element, batch_rows):
        yield list(_gather_batches(block, element, first_row))
        first_row += len(block)


def skip_element(lines: TextLines, element: PlyElement) -> None:
    """Move behind an ascii element that nobody needs."""
    for _ in _iter_blocks(lines, element, element.count):
        pass


def _iter_blocks(lines: TextLines, element: PlyElement, batch_rows: int) -> Iterator[TextBlock]:
    if not element.properties:
        return
    num_done = 0
    while num_done < element.count:
        block = lines.take(min(batch_rows, element.count - num_done))
        if block is None:
            raise cut_short_error(element, num_done)
        num_done += len(block)
        yield block


def _gather_batches(block: TextBlock, element: PlyElement, first_row: int) -> Iterator[RowBatch]:
    values = block.to_values()
    ends = np.cumsum(block.num_values)
    starts = ends - block.num_values
    groups: dict[tuple[int, ...], list[int]] = {}
    for row, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        lengths = _list_lengths(values, element, start, end)
        if lengths is None:
            raise ScanDamagedError(
                f"Line {block.numbers[row]:,} does not fit the lists of the PLY element {element.name!r}: "
                f"{block.excerpt(row)}. The file is damaged; export the scan again."
            )
        groups.setdefault(lengths, []).append(row)
    for lengths, rows in groups.items():
        dtype = _record_dtype(element, lengths)
        num_values = dtype.itemsize // 8
        records = values[starts[rows][:, None] + np.arange(num_values)].view(dtype)[:, 0]
        yield RowBatch(np.array(rows) + first_row, records)


def _list_lengths(values: NDArray[np.float64], element: PlyElement, start: int, end: int) -> tuple[int, ...] | None:
    lengths = []
    position = start
    for prop in element.properties:
        if position >= end:
            return None
        if prop.count_type is not None:
            length = values[position]
            if not 0 <= length < end - position or length != int(length):
                return None
            lengths.append(int(length))
            position += int(length)
        position += 1
    return tuple(lengths) if position == end else None


def _record_dtype(element: PlyElement, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    fields: list[Any] = []
    remaining = iter(lengths)
    for prop in element.properties:
        if prop.count_type is None:
            fields.append((prop.name, np.float64))
        else:
            fields += [(f"{prop.name} length", np.float64), (prop.name, np.float64, (next(remaining),))]
    return np.dtype(fields)
