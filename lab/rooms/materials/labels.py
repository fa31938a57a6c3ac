"""Object classes and their fixed label colors, for scans and panoramas that carry semantics instead of colors."""

import numpy as np
from numpy.typing import NDArray

LABEL_COLORS: dict[str, tuple[int, int, int]] = {
    "wall": (174, 199, 232),
    "floor": (152, 223, 138),
    "ceiling": (78, 71, 183),
    "door": (214, 39, 40),
    "window": (197, 176, 213),
    "trim": (196, 156, 148),
    "cabinet": (31, 119, 180),
    "bed": (255, 187, 120),
    "chair": (188, 189, 34),
    "sofa": (140, 86, 75),
    "table": (255, 152, 150),
    "bookshelf": (148, 103, 189),
    "picture": (213, 92, 176),
    "lamp": (255, 237, 111),
    "plant": (44, 160, 44),
    "rug": (219, 219, 141),
    "screen": (100, 85, 144),
    "curtain": (247, 182, 210),
    "radiator": (66, 188, 102),
    "appliance": (254, 127, 13),
    "person": (82, 84, 163),
    "box": (23, 190, 207),
    "road": (128, 64, 128),
    "pavement": (244, 35, 232),
    "building": (70, 70, 70),
    "tree": (107, 142, 35),
    "car": (0, 0, 142),
    "pole": (153, 153, 153),
    "sky": (70, 130, 180),
}
LABEL_TABLE: NDArray[np.uint8] = np.array(list(LABEL_COLORS.values()), np.uint8)


def label_number(name: str) -> int:
    """Return the row of `name` in `LABEL_TABLE`."""
    return list(LABEL_COLORS).index(name)
