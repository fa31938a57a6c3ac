"""How the coordinates of a file become those of the map: axes are exchanged, and lengths become metres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.options import METRES_PER_UNIT, Unit, UpAxis

Array = NDArray[np.float64]

# US survey feet are 2 millionths longer than international ones.
UNIT_TOLERANCE = 1e-5
# Which axes of the file become x, y and z, and their signs. Each is a rotation.
_TURNS: dict[UpAxis, tuple[tuple[int, int, int], tuple[float, float, float]]] = {
    "z": ((0, 1, 2), (1.0, 1.0, 1.0)),
    "y": ((0, 2, 1), (1.0, -1.0, 1.0)),
    "x": ((1, 2, 0), (1.0, 1.0, 1.0)),
    "-z": ((0, 1, 2), (1.0, -1.0, -1.0)),
    "-y": ((0, 2, 1), (1.0, 1.0, -1.0)),
    "-x": ((2, 1, 0), (1.0, 1.0, -1.0)),
}


@dataclass(frozen=True)
class ScanFrame:
    """metres: in a unit of the file. height_metres: likewise along `up_axis`, the axis of the file that points up."""

    metres: float = 1.0
    height_metres: float = 1.0
    up_axis: UpAxis = "z"

    def to_map(self, positions: Array) -> Array:
        """Return positions (N, 3) of the file in metres, z up; the same array where they are that already."""
        order, signs = _TURNS[self.up_axis]
        scales = np.array(signs) * [self.metres, self.metres, self.height_metres]
        if self.up_axis == "z" and np.all(scales == 1.0):
            return positions
        turned: Array = np.ascontiguousarray(positions[:, order]) * scales
        return turned

    @property
    def turn_words(self) -> str:
        """Return what became of x, y and z: such as "(x, −z, y)"."""
        order, signs = _TURNS[self.up_axis]
        return (
            f"({', '.join(('−' if sign < 0 else '') + 'xyz'[axis] for axis, sign in zip(order, signs, strict=True))})"
        )


@dataclass(frozen=True)
class ReadAs:
    """How a scan was read, and who says so: "given", "file" or "judged" by what was scanned; "assumed" without any of them.

    unit, height_unit: None for units that have no name here.
    """

    unit: Unit | None
    height_unit: Unit | None
    up_axis: UpAxis
    unit_from: str
    height_unit_from: str
    up_axis_from: str


def nearest_unit(metres: float) -> Unit:
    """Return the unit whose length is the most similar."""
    return min(METRES_PER_UNIT, key=lambda unit: abs(METRES_PER_UNIT[unit] / metres - 1))


def unit_of(metres: float) -> Unit | None:
    """Return the unit that is so long; None where there is none."""
    nearest = nearest_unit(metres)
    return nearest if abs(METRES_PER_UNIT[nearest] / metres - 1) < 1e-9 else None
