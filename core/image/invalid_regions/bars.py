"""Bars along the borders: rows or columns of one flat color, as letter boxes and panoramas of a limited height have them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from panoloc.core.image.invalid_regions.flat_colors import color_name

Mask = NDArray[np.bool_]

_FLAT_LEVELS = 6  # between the lightest and the darkest pixel of a row
_LEAST_PART, _MOST_PART = 0.012, 0.45  # of the image's height or width
_EDGE_LEVELS = 14  # by which what comes next differs from the bar
_EDGE_SHARE = 0.6  # of the columns; the rim of a flat ceiling is nowhere parallel to the rows for so long
_RIPPLE_PX = 18  # before the edge, which JPEG's blocks fill with ripples
_ABRUPT_PX = 3
_RIM_PX = 2  # of mixed pixels between bar and picture ...
_LEAST_WITH_RIM_PX = 200  # ... of a side at least this long; in a smaller image they would be degrees


def find_bars(planes: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> Iterator[tuple[str, Mask]]:
    """Yield name and mask (h, w) of the bars of each direction in an image (3, h, w), if there are any."""
    for axis, sides in ((0, "above or below"), (1, "left or right")):
        turned, counts = (planes, valid) if axis == 0 else (planes.swapaxes(1, 2), valid.T)
        found, colors = np.zeros(counts.shape, np.bool_), set()
        for view, mask, seen in ((turned, found, counts), (turned[:, ::-1], found[::-1], counts[::-1])):
            thick = _thickness(view) if seen[0].any() else 0
            if thick:
                mask[: thick + (_RIM_PX if len(mask) >= _LEAST_WITH_RIM_PX else 0)] = True
                colors.add(color_name(np.median(view[:, : thick // 2 + 1], axis=(1, 2))))
        if found.any():
            yield f"a flat {' and '.join(sorted(colors))} bar {sides}", found if axis == 0 else found.T


def _thickness(planes: NDArray[np.uint8]) -> int:
    """Return how many rows from the first on are one bar, 0 where none is."""
    most = int(_MOST_PART * planes.shape[1])
    sample = planes[:, : most + _RIPPLE_PX, ::4].astype(np.int16)
    start = np.median(sample[:, 0], axis=1)[:, None]
    low, high = sample.min(axis=2), sample.max(axis=2)
    flat = ((high - low) <= _FLAT_LEVELS).all(axis=0) & (np.abs((low + high) / 2 - start) <= _FLAT_LEVELS).all(axis=0)
    calm = len(flat) if flat.all() else int(flat.argmin())
    if not _LEAST_PART * planes.shape[1] - _RIPPLE_PX < calm <= most or calm < 2:
        return 0
    rows = sample[:, calm : calm + _RIPPLE_PX]
    differs = (np.abs(rows - start[..., None]) > _EDGE_LEVELS).any(axis=0).mean(axis=1)
    if differs.max() < _EDGE_SHARE:
        return 0
    edge = int((differs >= _EDGE_SHARE).argmax())
    before = differs[edge - _ABRUPT_PX] if edge >= _ABRUPT_PX else 0.0
    thick = calm + edge
    return thick if before <= _EDGE_SHARE / 2 and thick >= _LEAST_PART * planes.shape[1] else 0
