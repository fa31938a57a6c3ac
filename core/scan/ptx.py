"""Read PTX scans: every station of the file with its pose; cells of the grid without a return are left out."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError
from panoloc.core.scan.format_detection import PTX_HEADER
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error
from panoloc.core.scan.text.table import TextBlock, TextLines

_MAX_COUNT = 1 << 40
_COLORED, _PLAIN = 7, 4
_COLUMNS = "x y z intensity"


@dataclass(frozen=True)
class _Station:
    """num_points: cells of the grid, also those without a return. rotation (3, 3), translation (3,): x_file = R x + t."""

    num_points: int
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]


def read_ptx(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of all coloured stations in the file's frame; colours are float64.

    Raises ScanDamagedError when a station is shorter or longer than its header says, ScanContentError without colour.
    """
    num_announced, num_colored, num_stations = 0, 0, 0
    with context.path.open("rb") as stream:
        lines = TextLines(stream)
        while (station := _read_station(lines)) is not None:
            num_announced += station.num_points
            context.options.check_num_points(num_announced)
            num_stations += station.num_points > 0
            is_colored = False
            for block in lines.iter_rows(station.num_points, "A station of the PTX file", "points"):
                is_colored = int(block.num_values[0]) == _COLORED
                if not is_colored and block.num_values[0] != _PLAIN:
                    raise _line_error(block, 0, f"{_COLUMNS}, or these and red green blue")
                table = block.to_table(_COLORED if is_colored else _PLAIN)
                if is_colored:
                    table = table[np.any(table[:, :3] != 0, axis=1)]
                    with np.errstate(invalid="ignore", over="ignore"):  # points that are nowhere are left out later
                        positions = table[:, :3] @ station.rotation.T + station.translation
                    yield RawChunk(positions, table[:, 4:], block.end_offset / context.size_bytes)
            num_colored += is_colored
    if num_stations and not num_colored:
        raise no_color_error(_COLUMNS)
    context.note_scans(num_stations, num_colored, "stations")


def _read_station(lines: TextLines) -> _Station | None:
    """Return the next station's header, None at the end of the file."""
    values: list[NDArray[np.float64]] = []
    first_line = 0
    while len(values) < len(PTX_HEADER):
        block = lines.take(len(PTX_HEADER) - len(values))
        if block is None and not values:
            return None
        if block is None:
            raise ScanDamagedError(f"The PTX file ends within the header of a station. {CUT_SHORT}")
        first_line = first_line or int(block.numbers[0])
        expected = np.array(PTX_HEADER[len(values) : len(values) + len(block)])
        wrong = np.flatnonzero(block.num_values != expected)
        if len(wrong):
            # Often the grid before it does not have the size that was announced.
            raise _line_error(block, int(wrong[0]), f"{expected[wrong[0]]} in the header of a PTX station")
        values += np.split(block.to_values(), np.cumsum(expected)[:-1])
    columns, rows = float(values[0][0]), float(values[1][0])
    if not (0 <= columns <= _MAX_COUNT and 0 <= rows <= _MAX_COUNT and columns % 1 == 0 and rows % 1 == 0):
        raise ScanDamagedError(
            f"Line {first_line:,} of the PTX file announces {columns:g} columns and {rows:g} rows; expected whole numbers. "
            "Export the scan again."
        )
    matrix = np.array(values[-4:]).T  # written for points as rows: [x y z 1] times the matrix
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], [0, 0, 0, 1]) or abs(np.linalg.det(matrix)) < 1e-9:
        raise ScanDamagedError(
            f"The PTX station at line {first_line:,} has a matrix that is not a pose (its last column should be 0 0 "
            "0 1). Export the scan again."
        )
    return _Station(int(columns) * int(rows), matrix[:3, :3], matrix[:3, 3])


def _line_error(block: TextBlock, row: int, expected: str) -> ScanDamagedError:
    return ScanDamagedError(
        f"Line {block.numbers[row]:,} has {block.num_values[row]} values, expected {expected}: {block.excerpt(row)}. "
        "Export the scan again."
    )
