"""Rows of binary PLY elements in bounded batches, with and without lists."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from core.errors import CUT_SHORT, ScanDamagedError
from core.scan.ply.header import PlyElement, PlyProperty, PlyType

BLOCK_BYTES = 1 << 23
MAX_ROW_BYTES = 1 << 24


@dataclass(frozen=True)
class RowBatch:
    """Rows whose lists have equal lengths: `records` has one field per property, lists as (n, length) fields.

    rows: (n,) which rows of the element these are.
    """

    rows: NDArray[np.int64]
    records: NDArray[np.void]


def iter_plain_rows(stream: BinaryIO, element: PlyElement, batch_rows: int) -> Iterator[NDArray[np.void]]:
    """Yield the rows of an element without lists as structured arrays."""
    row_dtype = _record_dtype(element, ())
    for start in range(0, element.count, batch_rows):
        num_rows = min(batch_rows, element.count - start)
        data = stream.read(num_rows * row_dtype.itemsize)
        if len(data) < num_rows * row_dtype.itemsize:
            raise cut_short_error(element, start + len(data) // row_dtype.itemsize)
        yield np.frombuffer(data, row_dtype)


def iter_list_rows(stream: BinaryIO, element: PlyElement) -> Iterator[list[RowBatch]]:
    """Yield the rows of an element with lists, block by block; the batches of a block hold its rows in any order."""
    num_done, data = 0, b""
    wanted = BLOCK_BYTES
    while num_done < element.count:
        more = stream.read(max(wanted - len(data), 0))
        data += more
        offsets, lengths, end = _walk_rows(data, element, element.count - num_done)
        if len(offsets):
            yield list(_gather_batches(data, element, num_done, offsets, lengths))
            num_done += len(offsets)
            data, wanted = data[end:], BLOCK_BYTES
        elif not more:
            raise cut_short_error(element, num_done)
        elif len(data) >= MAX_ROW_BYTES:
            raise ScanDamagedError(f"Row {num_done} of the PLY element {element.name!r} holds an impossibly long list.")
        else:
            wanted = len(data) * 2
    stream.seek(-len(data), 1)


def skip_element(stream: BinaryIO, element: PlyElement) -> None:
    """Move `stream` behind a binary element that nobody needs."""
    if not element.has_lists:
        stream.seek(element.count * element.min_row_bytes(is_ascii=False), 1)
        return
    for _ in iter_list_rows(stream, element):
        pass


def cut_short_error(element: PlyElement, num_found: int) -> ScanDamagedError:
    """Return the error for an element that ends before its announced count."""
    return ScanDamagedError(
        f"The PLY header announces {element.count:,} rows of {element.name!r}, but the file ends after "
        f"{num_found:,}. {CUT_SHORT}"
    )


def _record_dtype(element: PlyElement, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    fields: list[Any] = []
    remaining = iter(lengths)
    for prop in element.properties:
        if prop.count_type is None:
            fields.append((prop.name, prop.type.dtype))
        else:
            fields += [(f"{prop.name} length", prop.count_type.dtype), (prop.name, prop.type.dtype, (next(remaining),))]
    return np.dtype(fields)


def _walk_rows(data: bytes, element: PlyElement, max_rows: int) -> tuple[list[int], list[tuple[int, ...]], int]:
    """Return where whole rows begin in `data`, the lengths of their lists, and where the last one ends."""
    steps = _row_steps(element.properties)
    offsets: list[int] = []
    lengths: list[tuple[int, ...]] = []
    position, size = 0, len(data)
    while len(offsets) < max_rows:
        cursor, row_lengths = position, []
        for skip, read_length, item_size in steps:
            cursor += skip
            if read_length is None:
                continue
            if cursor + read_length.size > size:
                return offsets, lengths, position
            (length,) = read_length.unpack_from(data, cursor)
            if length < 0:
                raise ScanDamagedError(f"A list of the PLY element {element.name!r} has the negative length {length}.")
            row_lengths.append(length)
            cursor += read_length.size + length * item_size
        if cursor > size:
            break
        offsets.append(position)
        lengths.append(tuple(row_lengths))
        position = cursor
    return offsets, lengths, position


def _row_steps(properties: tuple[PlyProperty, ...]) -> list[tuple[int, struct.Struct | None, int]]:
    """Return how to walk a row: bytes to skip, then the length to read (or None at the end), then its item size."""
    steps: list[tuple[int, struct.Struct | None, int]] = []
    skip = 0
    for prop in properties:
        if prop.count_type is None:
            skip += prop.type.num_bytes
            continue
        steps.append((skip, struct.Struct(_struct_format(prop.count_type)), prop.type.num_bytes))
        skip = 0
    return [*steps, (skip, None, 0)]


def _struct_format(count_type: PlyType) -> str:
    return count_type.order + np.dtype(count_type.dtype).char


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
