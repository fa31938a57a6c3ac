"""Z-buffered splatting, one point at a time, for points so far away that none covers more than its own pixel."""

import math

import numpy as np
from numpy.typing import NDArray

from tests.reference.spherical_twin import image_position_of

Array = NDArray[np.float64]


def splat(
    points: Array, colors: Array, center: Array, spacing: float, height: int, width: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return depth (H, W), inf where nothing is; mean colour (H, W, 3) of the front surface; and which points belong to it (N,).

    The front surface of a pixel reaches 2 % of its depth and four point spacings behind its nearest point.
    """
    depth = np.full((height, width), math.inf)
    pixels = []
    for point in points:
        u, v = image_position_of(point - center, height, width)
        pixel = min(int(v), height - 1), min(int(u), width - 1)
        pixels.append(pixel)
        depth[pixel] = min(depth[pixel], float(np.linalg.norm(point - center)))
    total, count = np.zeros((height, width, 3)), np.zeros((height, width))
    visible = np.zeros(len(points), bool)
    for number, (point, color, pixel) in enumerate(zip(points, colors, pixels, strict=True)):
        if float(np.linalg.norm(point - center)) <= depth[pixel] * 1.02 + 4 * spacing:
            visible[number] = True
            total[pixel] += color
            count[pixel] += 1
    with np.errstate(invalid="ignore"):
        return depth, total / count[..., None], visible
