"""Draw a scan from above, without its ceiling: floor plans for people."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from PIL import Image

EMPTY = 250
"""Grey of what the scan does not show."""
_NARROWEST = 16  # pixels
_GAP_PASSES = 2
_FEWEST_NEIGHBOURS = 4  # of eight: spots that thinning leaves in floors close, what lies outside does not grow


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
    picture = np.full((height, width, 3), EMPTY, dtype=np.uint8)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    picture[y[inside], x[inside]] = colors[cut][order][inside]
    shown = np.zeros((height, width), dtype=np.bool_)
    shown[y[inside], x[inside]] = True
    picture = _with_gaps_closed(picture, shown)
    enlarged = Image.fromarray(picture).resize((2 * width, 2 * height), Image.Resampling.NEAREST)
    return SeenFromAbove(np.asarray(enlarged, dtype=np.uint8), area, 2 * scale)


def _with_gaps_closed(picture: NDArray[np.uint8], shown: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Fill pixels of a picture (H, W, 3) without a point by the mean of their neighbours, where most have one; shown: (H, W)."""
    for _ in range(_GAP_PASSES):
        counts = _sum_around(shown.astype(np.float32))
        mean = _sum_around((picture * shown[..., None]).astype(np.float32)) / np.maximum(counts, 1)[..., None]
        gaps = ~shown & (counts >= _FEWEST_NEIGHBOURS)
        picture = np.where(gaps[..., None], mean, picture).astype(np.uint8)
        shown = shown | gaps
    return picture


def _sum_around(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sum over each pixel (H, W, …) and its eight neighbours."""
    padded = np.pad(values, [(1, 1), (1, 1), *[(0, 0)] * (values.ndim - 2)])
    return np.asarray(sliding_window_view(padded, (3, 3), axis=(0, 1)).sum(axis=(-1, -2)))


def _cells(
    positions: NDArray[np.floating], area: Area, scale: float, height: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    x = ((positions[:, 0] - area.lower[0]) * scale).astype(np.int64)
    return x, height - 1 - ((positions[:, 1] - area.lower[1]) * scale).astype(np.int64)
