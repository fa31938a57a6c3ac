"""Find what is not the place from the decoded pixels alone, and say so in words for people."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.image.invalid_regions.bars import find_bars
from panoloc.core.image.invalid_regions.flat_colors import is_label_image
from panoloc.core.image.invalid_regions.flat_void import find_voids
from panoloc.core.image.invalid_regions.poles import find_polar_fills

Mask = NDArray[np.bool_]

_MAX_SPHERE_PX, _MAX_PHOTO_PX = 1024, 512  # columns of the copy that is looked at
_LEAST_SIDE_PX = 32
_LEAST_SHARE = 0.002  # of the image; less changes no pose
# Noise of a covered lens, and of JPEG.
_BLANK_STEP = 4
_BLANK_SHARE = 0.995
_BLANK_EVERY = 8  # rows and columns
_MOST_SHARE = 0.9  # what leaves less than the rest is no defect but a picture of something flat


@dataclass(frozen=True)
class Found:
    """What is not the place.

    missing: (H, W) bool. words: one sentence per kind of thing that was found.
    """

    missing: Mask
    words: tuple[str, ...]


def find_missing(color: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> Found:
    """Find bars, void and filled poles in an image (H, W, 3), of whose pixels (H, W) `valid` are known to count.

    An image of one colour all over is said to be one, and nothing of it is taken out.

    is_sphere: the image is a full equirectangular sphere, which wraps around and has poles. Images of semantic labels, flat by nature,
    are left alone. People and tripods are not looked for.
    """
    step = -(-color.shape[1] // (_MAX_SPHERE_PX if is_sphere else _MAX_PHOTO_PX))
    # Picked, not averaged: what is exactly flat has to stay so.
    planes = np.ascontiguousarray(color[::step, ::step].transpose(2, 0, 1))
    counts = np.ascontiguousarray(valid[::step, ::step])
    missing = np.zeros(counts.shape, np.bool_)
    whole = "panorama" if is_sphere else "photo"
    if _is_blank(planes, counts):
        words = (
            f"the {whole} has a single colour and shows no place; check whether the lens was covered or the export "
            "failed"
        )
        return Found(np.zeros(valid.shape, np.bool_), (words,))
    if min(counts.shape) < _LEAST_SIDE_PX or is_label_image(planes):
        return Found(np.zeros(valid.shape, np.bool_), ())
    weight = _weights(len(counts), is_sphere)
    said = []
    for find in (find_bars, find_polar_fills, find_voids):
        for name, found in find(planes, counts & ~missing, is_sphere):
            share = float((found & counts & ~missing).mean(axis=1) @ weight)
            left = float((counts & ~missing & ~found).mean(axis=1) @ weight)
            if share < _LEAST_SHARE or left < 1 - _MOST_SHARE:
                continue
            missing |= found
            said.append(f"{share:.0%} of the {whole} is {name} and was left out; send a mask to override this")
    return Found(_enlarged(missing, step, valid.shape), tuple(said))


def _is_blank(planes: NDArray[np.uint8], counts: Mask) -> bool:
    """Tell whether what counts of an image (3, H, W) is of one colour, but for noise."""
    colors = planes[:, ::_BLANK_EVERY, ::_BLANK_EVERY][:, counts[::_BLANK_EVERY, ::_BLANK_EVERY]].astype(np.int16)
    if not colors.size:
        return False
    away = np.abs(colors - np.median(colors, axis=1, keepdims=True)).max(axis=0)
    return bool(np.mean(away <= _BLANK_STEP) >= _BLANK_SHARE)


def _weights(rows: int, is_sphere: bool) -> NDArray[np.float64]:
    """Return the share of each row in the whole: by solid angle on a sphere."""
    weight = np.sin(np.pi * (np.arange(rows) + 0.5) / rows) if is_sphere else np.ones(rows)
    return np.asarray(weight / weight.sum())


def _enlarged(mask: Mask, step: int, shape: tuple[int, ...]) -> Mask:
    if step == 1:
        return mask
    return np.repeat(np.repeat(mask, step, axis=0), step, axis=1)[: shape[0], : shape[1]]
