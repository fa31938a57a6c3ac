"""Points of a scan seen from above, without what lies over them: floor plans for people."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_EMPTY = 250  # grey of what the scan does not show
_NARROWEST = 16  # pixels


@dataclass(frozen=True)
class Area:
    """What is drawn: from lower to upper, each (2,), metres along x and y; of points up to the height top_m."""

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    top_m: float


@dataclass(frozen=True)
class SeenFromAbove:
    """picture: (H, W, 3) uint8, x to the right, y up. area: what it shows. pixels_per_m: its scale."""

    picture: NDArray[np.uint8]
    area: Area
    pixels_per_m: float

    def pixels_of(self, positions: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return column and row (N, 2) of positions (N, 2 or 3) in metres, which may lie outside of the picture."""
        columns, rows = _cells(positions, self.area, self.pixels_per_m / 2, self.picture.shape[0] // 2)
        return np.stack([2 * columns, 2 * rows], axis=1)


def draw_from_above(
    positions: NDArray[np.floating], colors: NDArray[np.uint8], area: Area, max_side: int
) -> SeenFromAbove:
    """Draw points (N, 3) with their colours (N, 3), the highest last; max_side: pixels of the longer side."""
    # Half the size, enlarged afterwards: a point is then two pixels wide and floors have fewer gaps.
    extent = area.upper - area.lower
    scale = max_side / 2 / max(float(extent.max()), 1e-3)
    width, height = (np.maximum(_NARROWEST, np.ceil(extent * scale))).astype(int)
    cut = positions[:, 2] <= area.top_m
    order = np.argsort(positions[cut, 2], kind="stable")
    x, y = _cells(positions[cut][order], area, scale, height)
    picture = np.full((height, width, 3), _EMPTY, dtype=np.uint8)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    picture[y[inside], x[inside]] = colors[cut][order][inside]
    enlarged = Image.fromarray(picture).resize((2 * width, 2 * height), Image.Resampling.NEAREST)
    return SeenFromAbove(np.asarray(enlarged, dtype=np.uint8), area, 2 * scale)


def _cells(
    positions: NDArray[np.floating], area: Area, scale: float, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    x = ((positions[:, 0] - area.lower[0]) * scale).astype(np.int64)
    return x, height - 1 - ((positions[:, 1] - area.lower[1]) * scale).astype(np.int64)
