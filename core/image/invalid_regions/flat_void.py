"""Void: parts that are exactly one color because nothing was there to be seen.

A void tells itself from a dark corner, a clipped window or a white wall by its rim. Light fades, so around what the camera clipped lies
what is nearly so, or clipped in one channel; a void ends at once, whatever the scene shows there. A void of a color that scenes have is
only believed where hardly anything else in the image is flat, because renderings have walls without any noise.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from panoloc.core.image.invalid_regions.cells import CELL_PX, Cells, cells_of
from panoloc.core.image.invalid_regions.components import connected_components, grown, spread
from panoloc.core.image.invalid_regions.flat_colors import color_name

Mask = NDArray[np.bool_]

_NEAR_LEVELS = 6  # of a void's pixels from its color: noise and JPEG
_LEAST_CELLS = 0.002  # of the image, for a component that shows that there is void
_LEAST_SHARE = 0.01  # of the image, of all components together
_RIM_PX = 2  # of mixed pixels around

# Shares of the cells around a component that may be shading; docs/formats.md has what these catch and miss.
_MOST_SHADED_BLACK, _MOST_SHADED_EXACT_BLACK, _MOST_SHADED, _MOST_SHADED_EXACT = 0.35, 0.7, 0.45, 0.6
_SHADE_LEVELS_BLACK, _SHADE_LEVELS_WHITE, _SHADE_LEVELS = 26, 40, 50
_CLIPPED_LEVEL = 250
# Shares of inner cells that are of exactly one color; cameras add noise to what is black in them, and leave shading in what is white.
_LEAST_EXACT_BLACK, _LEAST_EXACT, _WITHOUT_NOISE = 0.97, 0.94, 0.985

_ONLY_FLAT_SHARE = 0.7  # of all cells without noise, for a color that scenes have
_LEAST_OTHER_SHARE = 0.03  # of the image, for such a color


def find_voids(planes: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> Iterator[tuple[str, Mask]]:
    """Yield name and mask (h, w) of the void of each color in an image (3, h, w), if there is any."""
    cells = cells_of(planes, valid)
    for target in _candidates(cells):
        solid = cells.seen & cells.within(target, _NEAR_LEVELS)
        void = _believed(solid, target, cells, is_sphere)
        if void.any():
            yield f"a flat {color_name(target)} void", _pixels(planes, target, void, solid & ~void, is_sphere)


def _candidates(cells: Cells) -> Iterator[NDArray[np.int16]]:
    """Yield the colors (3,) that a void may have: black, white, and what nearly all flat cells have."""
    exact = cells.seen & (cells.low == cells.high).all(axis=0)
    for level in (0, 255):
        target = np.full(3, level, np.int16)
        extreme = cells.within(target, _NEAR_LEVELS)
        exact &= ~extreme
        if (cells.seen & extreme).sum() >= _LEAST_SHARE * extreme.size:
            yield target
    if exact.sum() < _LEAST_OTHER_SHARE * exact.size:
        return
    red, green, blue = cells.low[:, exact].astype(np.int64)
    codes, counts = np.unique((red << 16) + (green << 8) + blue, return_counts=True)
    commonest = int(codes[counts.argmax()])
    target = np.array([commonest >> 16, commonest >> 8 & 255, commonest & 255], np.int16)
    same = (exact & cells.within(target, 2)).sum()
    if same >= max(_ONLY_FLAT_SHARE * exact.sum(), _LEAST_OTHER_SHARE * exact.size):
        yield target


def _believed(solid: Mask, target: NDArray[np.int16], cells: Cells, wraps: bool) -> Mask:
    """Return the cells of those components that end at once, and small ones of that kind beside large ones."""
    labels = connected_components(solid, wraps)
    num = int(labels.max()) + 1
    once = grown(labels, wraps)
    ring = np.where((once == 0) & cells.seen, grown(once, wraps), 0)
    inner = ~spread(~solid, 1, wraps)
    size, around, within = (np.bincount(of.ravel(), minlength=num) for of in (labels, ring, labels * inner))
    shaded = np.bincount(ring[_shading(target, cells)], minlength=num) / np.maximum(around, 1)
    exact = np.bincount(labels[inner & cells.within(target, 1)], minlength=num) / np.maximum(within, 1)
    if target.any():
        hard = (shaded <= _MOST_SHADED) & ((exact >= _LEAST_EXACT) | (within == 0))
        hard |= (shaded <= _MOST_SHADED_EXACT) & (exact >= _WITHOUT_NOISE)
    else:
        hard = (shaded <= _MOST_SHADED_BLACK) | ((shaded <= _MOST_SHADED_EXACT_BLACK) & (exact >= _LEAST_EXACT_BLACK))
    hard &= around > 0
    hard[0] = False
    large = hard & (size >= _LEAST_CELLS * solid.size) & (within > 0)
    if size[hard].sum() < _LEAST_SHARE * solid.size or not large.any():
        return np.zeros(solid.shape, np.bool_)
    return np.asarray(hard[labels])


def _shading(target: NDArray[np.int16], cells: Cells) -> Mask:
    """Return the cells (h, w) that may be the shaded rim of something of this color."""
    if not target.any():
        return cells.within(target, _SHADE_LEVELS_BLACK)
    if target.min() == 255:
        clipped: Mask = cells.high.max(axis=0) >= _CLIPPED_LEVEL
        return cells.within(target, _SHADE_LEVELS_WHITE) | clipped
    return cells.within(target, _SHADE_LEVELS)


def _pixels(planes: NDArray[np.uint8], target: NDArray[np.int16], void: Mask, rejected: Mask, wraps: bool) -> Mask:
    """Return the pixels (h, w) of a void: those of its color in and beside its cells, and its rim."""
    reach = spread(void, 1, wraps) & ~rejected
    near = np.zeros(planes.shape[1:], np.bool_)
    near[: reach.shape[0] * CELL_PX, : reach.shape[1] * CELL_PX] = reach.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
    beyond = _NEAR_LEVELS + 2
    for plane, level in zip(planes, target.tolist(), strict=True):
        if level - beyond > 0:
            near &= plane >= level - beyond
        if level + beyond < 255:
            near &= plane <= level + beyond
    return spread(near, _RIM_PX, wraps)
