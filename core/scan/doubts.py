"""Questions about unit, heights and up axis of a scan, each with the answers to choose from and what they lead to."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from panoloc.core.options import METRES_PER_UNIT, Unit, UpAxis
from panoloc.core.scan.frame import Array, ReadAs, ScanFrame, nearest_unit
from panoloc.core.scan.gravity import AxisLook, Storey
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.storeys import LEAST_STOREY_M

HIGHEST_STOREY_M = 6.0
LEAST_EXTENT_M = 0.5
"""Of the longest side of a place."""
JUDGED_UNITS: tuple[Unit, ...] = ("m", "ft", "cm", "mm")
"""Of these no two are right for the same storey."""
_WORDS: dict[Unit, str] = {
    "m": "metres",
    "cm": "centimetres",
    "mm": "millimetres",
    "ft": "feet",
    "us-ft": "US survey feet",
}
_AXES: tuple[UpAxis, ...] = ("z", "-z", "y", "-y", "x", "-x")


@dataclass(frozen=True)
class Seen:
    """A scan as it is read so far. positions: (N, 3) metres, z up. looks: along x, y and z. axis: the likeliest vertical."""

    positions: Array
    looks: list[AxisLook]
    axis: int

    @property
    def storey(self) -> Storey | None:
        """Return what was found along that vertical."""
        return self.looks[self.axis].storey


def ask_up_axis(context: ReadingContext, read_as: ReadAs, seen: Seen, up: UpAxis, is_sure: bool, metres: float) -> None:
    """Ask which axis points up. up: by what was scanned.

    metres: by which the positions seen become metres, where their unit is judged.
    """
    found = f"{up} points up" if is_sure else "it is not certain which axis points up"
    was_taken = "was given" if read_as.up_axis_from == "given" else "was taken"
    choices = []
    for axis in _AXES:
        storey = seen.looks["xyz".index(axis[-1])].storey
        if storey is not None or axis in ("z", up, read_as.up_axis):
            turned = ScanFrame(metres, metres, axis).to_map(seen.positions)
            height = None if storey is None else storey.height * metres
            choices.append(_choice(f"{axis} up", {"up_axis": axis}, turned, height))
    message = f"From its floor, ceiling and walls {found}; {read_as.up_axis} {was_taken}."
    context.ask("up_axis_doubtful", message, "Which axis of the scan points up?", choices)


def ask_unit(context: ReadingContext, frame: ScanFrame, read_as: ReadAs, seen: Seen, storey: Storey) -> None:
    """Ask for the unit of coordinates whose storeys are too low or too high."""
    height, unit, height_unit = storey.height, nearest_unit(frame.metres), nearest_unit(frame.height_metres)
    code = "heights_doubtful" if read_as.unit_from == "file" else "unit_doubtful"
    message = (
        f"With heights in {_WORDS[height_unit]} there are {height:.2f} m between floor and ceiling; expected "
        f"{LEAST_STOREY_M:g} to {HIGHEST_STOREY_M:g} m."
    )
    choices = [_choice("as it is", {"unit": unit, "height_unit": height_unit}, seen.positions, height)]
    for other in JUDGED_UNITS:
        scale = METRES_PER_UNIT[other] / frame.height_metres
        if not LEAST_STOREY_M <= height * scale <= HIGHEST_STOREY_M:
            continue
        words, scales = _WORDS[other], np.ones(3)
        if other != unit:
            scaled = seen.positions * (METRES_PER_UNIT[other] / frame.metres)
            choices.append(_choice(f"all in {words}", {"unit": other, "height_unit": other}, scaled, height * scale))
        scales[seen.axis] = scale
        patch = {"unit": unit, "height_unit": other}
        choices.append(_choice(f"heights in {words}", patch, seen.positions * scales, height * scale))
    context.ask(code, message, "Which unit are the coordinates in?", choices)


def ask_assumed_unit(context: ReadingContext, seen: Seen) -> None:
    """Ask for the unit where neither the file nor a storey tells it."""
    message = "The file does not say its unit, and there is no floor with a ceiling to judge it by; metres were taken."
    choices = [
        _choice(_WORDS[unit], {"unit": unit, "height_unit": unit}, seen.positions * METRES_PER_UNIT[unit], None)
        for unit in JUDGED_UNITS
    ]
    context.ask("unit_doubtful", message, "Which unit are the coordinates in?", choices)


def ask_tiny(context: ReadingContext, frame: ScanFrame, positions: Array) -> None:
    """Ask for the unit where the one that was given makes the scan smaller than any place; positions: as it was given."""
    extent = float(np.ptp(positions, axis=0).max())
    message = f"In {_WORDS[nearest_unit(frame.metres)]}, as was given, the scan is only {100 * extent:.1f} cm long."
    choices = []
    for unit in JUDGED_UNITS:
        scale = METRES_PER_UNIT[unit] / frame.metres
        if extent * scale >= LEAST_EXTENT_M:
            choices.append(_choice(_WORDS[unit], {"unit": unit, "height_unit": unit}, positions * scale, None))
    context.ask("unit_doubtful", message, "Which unit are the coordinates in?", choices)


def ask_feet(context: ReadingContext, seen: Seen, storey: Storey) -> None:
    """Ask which of the two kinds of feet a scan is in that lies far from the origin."""
    message = "By the heights of its rooms and tables the scan is in feet; so far from the origin it matters which."
    choices = []
    for unit in ("ft", "us-ft"):
        metres = METRES_PER_UNIT[unit]
        patch = {"unit": unit, "height_unit": unit}
        choices.append(_choice(_WORDS[unit], patch, seen.positions * metres, storey.height * metres))
    context.ask("unit_doubtful", message, "Which feet are the coordinates in?", choices)


def _choice(label: str, patch: dict[str, Any], positions: Array, height: float | None) -> dict[str, Any]:
    """Return an answer: its name, the body for `PATCH /maps/{id}`, and the storey and the extent that it leads to."""
    extent = [round(float(side), 3) for side in np.ptp(positions, axis=0)]
    return {
        "label": label,
        "patch": patch,
        "storey_height_m": None if height is None else round(height, 3),
        "extent_m": extent,
    }
