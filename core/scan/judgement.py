"""Unit, heights and up axis of a scan: as given, else as its file says, else by what a building looks like.

What was given or said and what was scanned may contradict each other. Then there is a question, with the answers to choose from.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.earth.georeference import CoordinateSystem
from panoloc.core.options import METRES_PER_UNIT, Unit, UpAxis
from panoloc.core.scan.doubts import (
    HIGHEST_STOREY_M,
    JUDGED_UNITS,
    LEAST_EXTENT_M,
    Seen,
    ask_assumed_unit,
    ask_feet,
    ask_tiny,
    ask_unit,
    ask_up_axis,
)
from panoloc.core.scan.frame import UNIT_TOLERANCE, Array, ReadAs, ScanFrame, unit_of
from panoloc.core.scan.gravity import Storey, look_along, up_axis_of
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.storeys import LEAST_STOREY_M, SurfaceCells, surface_cells

# Tables and seats are lower than this; in feet, taken for metres, they are higher.
_HIGHEST_TABLE_M = 1.15
_FEWEST_TABLES = 8  # pieces of surfaces
# Of walls over floors: halls have less, scans whose heights alone are in feet have more.
_WALLS_OF_ROOMS = (1.0, 8.0)
_SMALLEST_PLAN_M2 = 8.0
# Farther from the origin than this the two kinds of feet differ by centimetres.
_FEET_DIFFER_FROM = 20_000.0


def judge(
    context: ReadingContext, system: CoordinateSystem | None, positions: Array, brightness: NDArray[np.float64] | None
) -> tuple[ScanFrame, ReadAs]:
    """Return how a scan is read, also in words with who says so, and note what is doubtful.

    positions: (N, 3) of the file. brightness: see `look_along`.
    """
    frame, read_as = _said(context, system)
    if context.is_part:
        return frame, read_as
    in_map = frame.to_map(positions)
    if read_as.unit_from == "given" and np.ptp(in_map, axis=0).max() < LEAST_EXTENT_M:
        ask_tiny(context, frame, in_map)
        return frame, read_as
    cells = surface_cells(in_map)
    looks = [look_along(cells, axis, in_map, brightness) for axis in range(3)]
    up, axis, is_sure = up_axis_of(looks)
    seen = Seen(in_map, looks, axis if is_sure or looks[2].storey is None else 2)
    storey = seen.storey
    unit = "m" if storey is None else _unit_by_height(cells, storey, seen, up)
    is_assumed = read_as.unit_from == read_as.height_unit_from == "assumed"
    metres = METRES_PER_UNIT[unit] if unit is not None and is_assumed else 1.0
    if up != "z" and is_sure and read_as.up_axis_from == "assumed":
        frame, read_as = replace(frame, up_axis=up), replace(read_as, up_axis=up, up_axis_from="judged")
    elif (up != "z" and is_sure) or (not is_sure and read_as.up_axis_from == "assumed"):
        ask_up_axis(context, read_as, seen, up, is_sure, metres)
    if storey is None and is_assumed and len(cells.centers):
        ask_assumed_unit(context, seen)
    if storey is None or unit == "m":
        return frame, read_as
    if unit is None or not is_assumed:
        ask_unit(context, frame, read_as, seen, storey)
        return frame, read_as
    if unit == "ft" and np.abs(positions).max() > _FEET_DIFFER_FROM:
        ask_feet(context, seen, storey)
    read_as = replace(read_as, unit=unit, height_unit=unit, unit_from="judged", height_unit_from="judged")
    return replace(frame, metres=metres, height_metres=metres), read_as


def _said(context: ReadingContext, system: CoordinateSystem | None) -> tuple[ScanFrame, ReadAs]:
    """Return how a scan is read as far as that is given or its file says it; for the rest metres and z are assumed."""
    metres, unit_from = _unit_said(context, system)
    height, height_from = _height_unit_said(context, system, metres)
    up_axis, axis_from = _up_axis_said(context, system)
    frame = ScanFrame(metres or 1.0, height or metres or 1.0, up_axis or "z")
    names = unit_of(frame.metres), unit_of(frame.height_metres), frame.up_axis
    return frame, ReadAs(*names, unit_from, height_from or unit_from, axis_from)


def _unit_said(context: ReadingContext, system: CoordinateSystem | None) -> tuple[float | None, str]:
    grid = None if system is None else system.metres_per_unit
    given = context.options.unit
    if given == "auto":
        metres = grid if context.unit is None else METRES_PER_UNIT[context.unit]
        return metres, "assumed" if metres is None else "file"
    metres = METRES_PER_UNIT[given]
    if grid is not None and abs(grid / metres - 1) < UNIT_TOLERANCE:
        metres = grid  # a coordinate system knows which of the two kinds of feet
    return metres, "given"


def _height_unit_said(
    context: ReadingContext, system: CoordinateSystem | None, metres: float | None
) -> tuple[float | None, str | None]:
    given = context.options.height_unit
    if given != "auto":
        return METRES_PER_UNIT[given], "given"
    if system is not None and system.height_metres_per_unit is not None and metres == system.metres_per_unit:
        return system.height_metres_per_unit, "file"
    if context.height_unit is not None and context.options.unit == "auto":
        return METRES_PER_UNIT[context.height_unit], "file"
    return None, None


def _up_axis_said(context: ReadingContext, system: CoordinateSystem | None) -> tuple[UpAxis | None, str]:
    given = context.options.up_axis
    if given != "auto" and given != context.turned_from:
        return given, "given"
    if context.up_axis is not None or system is not None:
        return context.up_axis or "z", "file"
    return None, "assumed"


def _unit_by_height(cells: SurfaceCells, storey: Storey, seen: Seen, up: UpAxis) -> Unit | None:
    """Return the unit in which a scan, read in metres, has a storey of usual height; None where that is not certain."""
    height, axis = storey.height, seen.axis
    fitting = [unit for unit in JUDGED_UNITS if LEAST_STOREY_M <= height * METRES_PER_UNIT[unit] <= HIGHEST_STOREY_M]
    if fitting == ["m"] or not fitting:
        return fitting[0] if fitting else None
    (unit,) = fitting
    along, slope = cells.centers[:, axis], np.abs(cells.normals[:, axis])
    from_floor = storey.ceiling.level - along if up.startswith("-") else along - storey.floor.level
    is_table = (slope > 0.9) & (from_floor > 1.5 * cells.size) & (from_floor < height / 2)
    table = float(np.median(from_floor[is_table])) if is_table.sum() >= _FEWEST_TABLES else None
    if unit == "ft" and table is not None and table <= _HIGHEST_TABLE_M:
        return "m"  # a hall
    sides = [float(np.ptp(np.quantile(seen.positions[:, each], (0.01, 0.99)))) for each in range(3) if each != axis]
    walls = float(np.mean(slope < 0.2)) / min(storey.floor.share, storey.ceiling.share)
    is_of_rooms = table is not None and _WALLS_OF_ROOMS[0] <= walls <= _WALLS_OF_ROOMS[1]
    is_wide = sides[0] * sides[1] * METRES_PER_UNIT[unit] ** 2 >= _SMALLEST_PLAN_M2
    return unit if is_wide and (unit != "ft" or is_of_rooms) else None
