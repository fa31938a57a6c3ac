"""Find what an image shows that is not the place, from the decoded pixels alone, and say so in words for people.

That is void: parts that have exactly one colour because nothing was there to be seen. Bars and plain caps around a pole are void too.

Three properties tell void from a dark corner, a blown window or a white wall. Void has exactly one colour, where cameras add noise. It ends
at once, where light fades. Hardly anything else in the image is flat, unlike in renderings and in images of labels.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Levels = NDArray[np.int16]

_BLANK_SHARE = 0.995  # of the cells that have the median colour
_CELL_PX = 4  # half of a block of JPEG
_NOISE_LEVELS = 6  # of a void's pixels from its colour, where JPEG ripples
_SHADE_LEVELS = 40  # of what may be the shaded rim of something that has the colour
# Shares chosen between what 130 panoramas with void show, and 800 panoramas and photos without, many of them overexposed or dim.
_LEAST_SHARE = 0.01  # of the image
_LEAST_COLORED = 0.05  # of the image, for a colour that things have
_MOST_SHARE = 0.9  # of the image; more is a picture of something flat
_LEAST_EXACT = 0.9  # of the inner cells of a void
_MOST_FLAT = 0.2  # of all other cells, black and white ones aside
_MOST_SHADED = 0.45  # of the cells around


def find_missing(color: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> tuple[Mask, tuple[str, ...]]:
    """Find flat void in an image (H, W, 3), of whose pixels (H, W) `valid` are known to count.

    Returns the pixels (H, W) that are not the place, and one sentence per kind of thing that was found.

    An image of one colour all over is said to be one, and nothing of it is taken out.

    is_sphere: the image is a full equirectangular sphere, and is called a panorama. People, tripods and logos are not looked for.
    """
    whole = "panorama" if is_sphere else "photo"
    missing = np.zeros(valid.shape, np.bool_)
    cells = _cells_of(color, valid)
    if not cells.seen.any():
        return missing, ()
    if cells.within(np.median(cells.low[cells.seen], axis=0), _NOISE_LEVELS)[cells.seen].mean() >= _BLANK_SHARE:
        words = (
            f"the {whole} has a single colour and shows no place; check whether the lens was covered or the export "
            "failed"
        )
        return missing, (words,)
    said = []
    for target, void in _find_voids(color, cells):
        share = float((void & valid & ~missing).mean())
        missing |= void
        said.append(
            f"{share:.0%} of the {whole} is a flat {_color_name(target)} void and was left out; "
            "send a mask to override this"
        )
    return missing, tuple(said)


def _color_name(rgb: list[int]) -> str:
    """Return "black", "white", or the colour in the notation of the web."""
    if max(rgb) <= _NOISE_LEVELS:
        return "black"
    return "white" if min(rgb) >= 255 - _NOISE_LEVELS else "#" + "".join(f"{level:02x}" for level in rgb)


@dataclass(frozen=True)
class _Cells:
    """The squares of a few pixels that an image consists of.

    low, high: (h, w, 3) int16, the least and the greatest value of each channel. seen: (h, w) bool, where all pixels count.
    """

    low: Levels
    high: Levels
    seen: Mask

    def within(self, target: NDArray[np.float64] | Levels, levels: int) -> Mask:
        """Return the cells (h, w) all of whose pixels are within `levels` of the colour (3,)."""
        return np.asarray(((self.low >= target - levels) & (self.high <= target + levels)).all(axis=-1))


def _cells_of(color: NDArray[np.uint8], valid: Mask) -> _Cells:
    """Return the cells of an image (H, W, 3), of whose pixels (H, W) `valid` count; what fills no cell is left out."""
    height, width = (side // _CELL_PX * _CELL_PX for side in valid.shape)

    def over_cells(combine: np.ufunc, values: NDArray[np.uint8] | Mask) -> NDArray[np.int16]:
        """Return values (H, W, ...) of pixels combined in each cell."""
        rows = reduce(combine, [values[i:height:_CELL_PX, :width] for i in range(_CELL_PX)])
        return np.asarray(reduce(combine, [rows[:, i::_CELL_PX] for i in range(_CELL_PX)]), np.int16)

    return _Cells(
        over_cells(np.minimum, color), over_cells(np.maximum, color), over_cells(np.logical_and, valid).astype(np.bool_)
    )


def _find_voids(color: NDArray[np.uint8], cells: _Cells) -> Iterator[tuple[list[int], Mask]]:
    """Yield colour (3) and mask (H, W) of a black void, a white one and one of another colour in an image (H, W, 3) of these cells."""
    flat = cells.seen & (cells.low == cells.high).all(axis=-1)
    black = flat & cells.within(np.zeros(3), _NOISE_LEVELS)
    white = flat & cells.within(np.full(3, 255.0), _NOISE_LEVELS)
    colored = flat & ~black & ~white
    for kind, least in ((black, _LEAST_SHARE), (white, _LEAST_SHARE), (colored, _LEAST_COLORED)):
        target = _commonest(cells.low[kind])
        solid = cells.seen & cells.within(target, _NOISE_LEVELS)
        if not kind.any() or not least <= solid.mean() <= _MOST_SHARE:
            continue
        inner = ~_spread(~solid, 2)  # no ripple of the rim reaches these: it ends with its block
        beside = _spread(solid, 1)
        others = cells.seen & ~beside
        around = others & _spread(beside, 1)
        shade = cells.within(target, _SHADE_LEVELS)
        if kind is white:  # light that clips one channel before the others
            shade |= cells.high.max(axis=-1) >= 255 - _NOISE_LEVELS
        if (
            (inner & cells.within(target, 0)).sum() >= _LEAST_EXACT * max(inner.sum(), 1)
            and (others & colored).sum() <= _MOST_FLAT * others.sum()
            and (around & shade).sum() <= _MOST_SHADED * around.sum()
        ):
            yield target.tolist(), _pixels(color, target, beside)


def _commonest(colors: Levels) -> Levels:
    """Return the commonest (3,) of colours (N, 3), black of none; JPEG makes a black of 1 or 2 of what was 0."""
    codes, counts = np.unique(colors @ np.array([1 << 16, 1 << 8, 1]), return_counts=True)
    commonest = int(codes[counts.argmax()]) if len(codes) else 0
    return np.array([commonest >> 16, commonest >> 8 & 255, commonest & 255], np.int16)


def _pixels(color: NDArray[np.uint8], target: Levels, beside: Mask) -> Mask:
    """Return the pixels (H, W) of a void: those of its colour in and beside its cells, and its rim."""
    near = np.zeros(color.shape[:2], np.bool_)
    reach = beside.repeat(_CELL_PX, axis=0).repeat(_CELL_PX, axis=1)
    near[: reach.shape[0], : reach.shape[1]] = reach
    near[near] = (np.abs(color[near] - target) <= _NOISE_LEVELS).all(axis=-1)
    return _spread(near, _CELL_PX // 2)  # pixels at the rim are mixed


def _spread(mask: Mask, reach: int) -> Mask:
    """Return the mask (h, w) with everything up to `reach` rows and columns away."""
    for axis in (0, 1):
        padded = np.pad(mask, [(reach, reach) if each == axis else (0, 0) for each in (0, 1)])
        mask = np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=axis).any(axis=-1))
    return mask
