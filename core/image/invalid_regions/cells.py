"""An image in cells of a few pixels, so that what is flat is found at a fraction of the cost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELL_PX = 4


@dataclass(frozen=True)
class Cells:
    """What the cells of an image hold.

    low, high: (3, h, w) int16, the least and the greatest value of each channel. seen: (h, w) bool, where all pixels count.
    """

    low: NDArray[np.int16]
    high: NDArray[np.int16]
    seen: NDArray[np.bool_]

    def within(self, target: NDArray[np.int16], levels: int) -> NDArray[np.bool_]:
        """Return the cells (h, w) all of whose pixels are within `levels` of the color (3,)."""
        color = target[:, None, None]
        return np.asarray(((self.low >= color - levels) & (self.high <= color + levels)).all(axis=0))


def cells_of(planes: NDArray[np.uint8], valid: NDArray[np.bool_]) -> Cells:
    """Return the cells of an image (3, H, W), of whose pixels (H, W) `valid` count; what fills no cell is left out."""
    height, width = (side // CELL_PX for side in valid.shape)
    low = high = planes[:, : height * CELL_PX, : width * CELL_PX]
    for axis in (1, 2):
        lower, higher = (
            [values[:, i::CELL_PX] if axis == 1 else values[..., i::CELL_PX] for i in range(CELL_PX)]
            for values in (low, high)
        )
        low, high = lower[0], higher[0]
        for i in range(1, CELL_PX):
            low, high = np.minimum(low, lower[i]), np.maximum(high, higher[i])
    inside = valid[: height * CELL_PX, : width * CELL_PX]
    rows = np.logical_and.reduce([inside[i::CELL_PX] for i in range(CELL_PX)])
    seen = np.logical_and.reduce([rows[:, i::CELL_PX] for i in range(CELL_PX)])
    return Cells(low.astype(np.int16), high.astype(np.int16), seen)
