"""The data of a PLY file, ascii or binary, element by element."""

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from core.scan.ply import ascii_body, binary_body
from core.scan.ply.binary_body import RowBatch
from core.scan.ply.header import PlyElement, PlyHeader
from core.scan.reading_context import CHUNK_ROWS
from core.scan.text.table import TextLines


class PlyBody:
    """Reads the elements of `header` from `stream` in the order of the file."""

    def __init__(self, stream: BinaryIO, header: PlyHeader):
        stream.seek(header.size_bytes)
        self._stream = stream
        self._lines = TextLines(stream, header.num_lines + 1) if header.is_ascii else None

    def skip(self, element: PlyElement) -> None:
        """Move behind `element`."""
        if self._lines is not None:
            ascii_body.skip_element(self._lines, element)
        else:
            binary_body.skip_element(self._stream, element)

    def iter_list_rows(self, element: PlyElement) -> Iterator[list[RowBatch]]:
        """Yield the rows of an element with lists, block by block."""
        if self._lines is not None:
            return ascii_body.iter_list_rows(self._lines, element, CHUNK_ROWS)
        return binary_body.iter_list_rows(self._stream, element)

    def iter_scalar_rows(self, element: PlyElement, names: list[str]) -> Iterator[NDArray[np.void]]:
        """Yield structured arrays that hold at least the scalar properties `names`, in the order of the file."""
        if element.has_lists:
            for batches in self.iter_list_rows(element):
                yield _merge_scalars(batches, names)
        elif self._lines is not None:
            yield from ascii_body.iter_plain_rows(self._lines, element, CHUNK_ROWS)
        else:
            yield from binary_body.iter_plain_rows(self._stream, element, CHUNK_ROWS)


def _merge_scalars(batches: list[RowBatch], names: list[str]) -> NDArray[np.void]:
    rows = np.concatenate([batch.rows for batch in batches])
    first_row = rows.min()
    dtypes = batches[0].records.dtype
    merged = np.empty(len(rows), [(name, dtypes[name]) for name in names])
    for batch in batches:
        for name in names:
            merged[name][batch.rows - first_row] = batch.records[name]
    return merged
