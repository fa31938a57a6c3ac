"""The header of one PTX station: how large its grid is, and where it stood."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.errors import CUT_SHORT, ScanDamagedError
from core.scan.text.table import TextBlock, TextLines

HEADER_VALUES = (1, 1, 3, 3, 3, 3, 4, 4, 4, 4)
"""Numbers on each line before the points: columns, rows, position and axes of the scanner, the matrix of its pose."""
_MATRIX_VALUES = 16
_MAX_COUNT = 1 << 40


@dataclass(frozen=True)
class PtxStation:
    """num_points: cells of the grid, those without a return included. rotation (3, 3), translation (3,): x_file = R x + t."""

    num_points: int
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


def read_station(lines: TextLines) -> PtxStation | None:
    """Return the next station's header, None at the end of the file. Raises ScanDamagedError."""
    blocks: list[TextBlock] = []
    num_lines = 0
    while num_lines < len(HEADER_VALUES):
        block = lines.take(len(HEADER_VALUES) - num_lines)
        if block is None and not blocks:
            return None
        if block is None:
            raise ScanDamagedError(f"The PTX file ends within the header of a station. {CUT_SHORT}")
        for row, num_values in enumerate(block.num_values.tolist()):
            if num_values != HEADER_VALUES[num_lines + row]:
                raise ScanDamagedError(
                    f"Line {block.numbers[row]:,} has {num_values} values, expected {HEADER_VALUES[num_lines + row]} in the "
                    f"header of a PTX station: {block.excerpt(row)}. The grid before it does not have the size that was "
                    "announced; export the scan again."
                )
        blocks.append(block)
        num_lines += len(block)
    return _station(np.concatenate([block.to_values() for block in blocks]), int(blocks[0].numbers[0]))


def _station(values: NDArray[np.float64], line: int) -> PtxStation:
    columns, rows = values[:2].tolist()
    if not (0 <= columns <= _MAX_COUNT and 0 <= rows <= _MAX_COUNT and columns % 1 == 0 and rows % 1 == 0):
        raise ScanDamagedError(
            f"Line {line:,} of the PTX file announces {columns:g} columns and {rows:g} rows; expected whole numbers. "
            "Export the scan again."
        )
    # Written for points as rows: [x y z 1] times the matrix.
    matrix = values[-_MATRIX_VALUES:].reshape(4, 4).T
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], [0, 0, 0, 1]) or abs(np.linalg.det(matrix)) < 1e-9:
        raise ScanDamagedError(
            f"The PTX station at line {line:,} has a matrix that is no pose (its last column should be 0 0 0 1). "
            "Export the scan again."
        )
    return PtxStation(int(columns) * int(rows), matrix[:3, :3], matrix[:3, 3])
