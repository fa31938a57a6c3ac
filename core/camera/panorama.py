"""A panorama: an equirectangular image with a mask of the pixels that count."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import PanoramaShapeError


@dataclass(frozen=True)
class Panorama:
    """A full-sphere equirectangular image.

    color: (H, W, 3) uint8, W = 2 H, RGB; row 0 looks up, the centre column looks forward (+x).
    valid: (H, W) bool; False marks pixels to ignore (missing, masked, outside a crop). Missing is a mask, never a colour.
    left_out: in words for people, what was found not to be the place, and is not valid for that.
    """

    color: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        height, width = self.valid.shape
        if self.color.shape != (height, width, 3) or width != 2 * height:
            raise PanoramaShapeError(
                f"panorama: expected color (H, 2H, 3) and valid (H, 2H), got {self.color.shape} and {self.valid.shape}"
            )
