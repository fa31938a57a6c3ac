"""The projection and the sampling of equirectangular images, one point at a time, from the sentences of the conventions.

Azimuth = π − 2π u / W, elevation = π/2 − π v / H; pixel centres lie at half-integers; the seam wraps, and rows beyond a pole continue
on the opposite meridian.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def direction_of(u: float, v: float, height: int, width: int) -> Array:
    """Return the unit viewing direction of one image position."""
    azimuth = math.pi - 2 * math.pi * u / width
    elevation = math.pi / 2 - math.pi * v / height
    return np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )


def image_position_of(point: Array, height: int, width: int) -> tuple[float, float]:
    """Return the image position (u, v) of one camera-frame point, u in [0, W)."""
    x, y, z = (float(value) for value in point)
    azimuth = math.atan2(y, x)
    elevation = math.asin(max(-1.0, min(1.0, z / math.sqrt(x * x + y * y + z * z))))
    u = (math.pi - azimuth) * width / (2 * math.pi)
    return u % width, (math.pi / 2 - elevation) * height / math.pi


def pixel_at(image: Array, row: int, column: int) -> Array:
    """Return pixel (row, column) of an (H, W, C) image; rows and columns outside of it continue as the sphere does."""
    height, width = image.shape[:2]
    if row < 0:
        row, column = -1 - row, column + width // 2
    elif row >= height:
        row, column = 2 * height - 1 - row, column + width // 2
    return np.asarray(image[row, column % width])


def sample(image: Array, u: float, v: float) -> Array:
    """Return the bilinear sample (C,) of an (H, W, C) image at one position."""
    left, top = math.floor(u - 0.5), math.floor(v - 0.5)
    right_share, bottom_share = u - 0.5 - left, v - 0.5 - top
    total = np.zeros(image.shape[2])
    for row, row_share in ((top, 1 - bottom_share), (top + 1, bottom_share)):
        for column, column_share in ((left, 1 - right_share), (left + 1, right_share)):
            total += row_share * column_share * pixel_at(image, row, column)
    return total


def pixel_solid_angle(row: int, height: int, width: int) -> float:
    """Return the solid angle in steradians of a pixel by numerical integration of cos(elevation)."""
    steps = 400
    total = 0.0
    for step in range(steps):
        elevation = math.pi / 2 - math.pi * (row + (step + 0.5) / steps) / height
        total += math.cos(elevation) * (math.pi / height / steps)
    return total * 2 * math.pi / width


def patch_of(direction: Array, rows: int, columns: int) -> int:
    """Return the patch whose centre is nearest in the image plane to the projection of a direction: argmin over all centres."""
    u, v = image_position_of(direction, rows, columns)
    best, nearest = -1, math.inf
    for row in range(rows):
        for column in range(columns):
            across = abs(column + 0.5 - u)
            distance = math.hypot(min(across, columns - across), row + 0.5 - v)
            if distance < nearest:
                best, nearest = row * columns + column, distance
    return best
