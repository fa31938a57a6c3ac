"""Read PTX scans: every station of the file with its pose; cells of the grid without a return are left out."""

from collections.abc import Iterator

import numpy as np

from core.errors import CUT_SHORT, ScanDamagedError
from core.scan.ptx.station import PtxStation, read_station
from core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error
from core.scan.text.table import TextBlock, TextLines

_COLORED, _PLAIN = 7, 4
_COLUMNS = "x y z intensity"


def read_ptx(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of all coloured stations in the file's frame; colours are float64.

    Raises ScanDamagedError when a station is shorter or longer than its header says, ScanContentError without colour.
    """
    num_announced, num_colored, num_stations = 0, 0, 0
    with context.path.open("rb") as stream:
        lines = TextLines(stream)
        while (station := read_station(lines)) is not None:
            num_announced += station.num_points
            context.options.check_num_points(num_announced)
            num_stations += station.num_points > 0
            is_colored = False
            for block in _iter_blocks(lines, station):
                num_columns = int(block.num_values[0])
                if num_columns not in (_COLORED, _PLAIN):
                    raise _columns_error(block, num_columns)
                table = block.to_table(num_columns)
                is_colored = num_columns == _COLORED
                if is_colored:
                    table = table[np.any(table[:, :3] != 0, axis=1)]
                    with np.errstate(
                        invalid="ignore", over="ignore"
                    ):  # points that are nowhere are left out later, and counted
                        positions = table[:, :3] @ station.rotation.T + station.translation
                    yield RawChunk(positions, table[:, 4:], block.end_offset / context.size_bytes)
            num_colored += is_colored
    if num_stations and not num_colored:
        raise no_color_error(_COLUMNS)
    _note_stations(context, num_stations, num_colored)


def _iter_blocks(lines: TextLines, station: PtxStation) -> Iterator[TextBlock]:
    num_done = 0
    while num_done < station.num_points:
        block = lines.take(min(CHUNK_ROWS, station.num_points - num_done))
        if block is None:
            raise ScanDamagedError(
                f"A station of the PTX file announces {station.num_points:,} points, but the file ends after "
                f"{num_done:,} of them. {CUT_SHORT}"
            )
        num_done += len(block)
        yield block


def _note_stations(context: ReadingContext, num_stations: int, num_colored: int) -> None:
    if num_colored < num_stations:
        context.note(
            "scans_without_color",
            f"{num_stations - num_colored} of {num_stations} stations in the file have no colour and were left out.",
            "warning",
        )
    if num_colored > 1:
        context.note("scans_merged", f"{num_colored} stations were merged with their poses.")


def _columns_error(block: TextBlock, num_columns: int) -> ScanDamagedError:
    return ScanDamagedError(
        f"Line {block.numbers[0]:,} has {num_columns} values, expected {_COLUMNS}, or these and red green blue: "
        f"{block.excerpt(0)}. Export the scan again."
    )
