"""What flat colors say: their names in messages, and images of semantic labels, which consist of them."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_BLACK_LEVEL, _WHITE_LEVEL = 12, 243
_MOST_CLASSES = 64
_SHARE_IN_CLASSES = 0.95  # of the pixels that do not have the commonest color; photographs are far below
_COMMON_SHARE = 0.01


def color_name(rgb: Iterable[float]) -> str:
    """Return "black", "white", or the color in the notation of the web."""
    levels = [round(float(level)) for level in rgb]
    if max(levels) <= _BLACK_LEVEL:
        return "black"
    if min(levels) >= _WHITE_LEVEL:
        return "white"
    return "#" + "".join(f"{level:02x}" for level in levels)


def is_label_image(planes: NDArray[np.uint8]) -> bool:
    """Tell whether nearly all pixels (3, H, W) have one of few colors, of which more than one is common."""
    red, green, blue = planes[:, ::4, ::4].astype(np.int32)
    counts = np.sort(np.unique((red << 16) + (green << 8) + blue, return_counts=True)[1])[::-1]
    rest = max(int(counts[1:].sum()), 1)
    common = int((counts > _COMMON_SHARE * counts.sum()).sum())
    return common >= 2 and int(counts[1:_MOST_CLASSES].sum()) >= _SHARE_IN_CLASSES * rest
