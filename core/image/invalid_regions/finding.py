"""Find what is not the place from the decoded pixels alone, and say so in words for people."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.image.invalid_regions.flat_void import NOISE_LEVELS, cells_of, find_voids

Mask = NDArray[np.bool_]

_BLANK_SHARE = 0.995  # of the cells that have the median colour


@dataclass(frozen=True)
class Found:
    """What is not the place.

    missing: (H, W) bool. words: one sentence per kind of thing that was found.
    """

    missing: Mask
    words: tuple[str, ...]


def find_missing(color: NDArray[np.uint8], valid: Mask, is_sphere: bool) -> Found:
    """Find flat void in an image (H, W, 3), of whose pixels (H, W) `valid` are known to count.

    An image of one colour all over is said to be one, and nothing of it is taken out.

    is_sphere: the image is a full equirectangular sphere, and is called a panorama. People, tripods and logos are not looked for.
    """
    whole = "panorama" if is_sphere else "photo"
    missing = np.zeros(valid.shape, np.bool_)
    cells = cells_of(color, valid)
    if not cells.seen.any():
        return Found(missing, ())
    if cells.within(np.median(cells.low[cells.seen], axis=0), NOISE_LEVELS)[cells.seen].mean() >= _BLANK_SHARE:
        words = (
            f"the {whole} has a single colour and shows no place; check whether the lens was covered or the export "
            "failed"
        )
        return Found(missing, (words,))
    said = []
    for target, void in find_voids(color, cells):
        share = float((void & valid & ~missing).mean())
        missing |= void
        said.append(
            f"{share:.0%} of the {whole} is a flat {_color_name(target)} void and was left out; "
            "send a mask to override this"
        )
    return Found(missing, tuple(said))


def _color_name(rgb: list[int]) -> str:
    """Return "black", "white", or the colour in the notation of the web."""
    if max(rgb) <= NOISE_LEVELS:
        return "black"
    return "white" if min(rgb) >= 255 - NOISE_LEVELS else "#" + "".join(f"{level:02x}" for level in rgb)
