"""Arrays of an index as few bytes: rounded to what their noise leaves of them, and laid out so that Huffman codes find little to say.

What the rounding costs is in docs/experiments.md ("How small may an index be?").
"""

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
COLOR_LEVELS = 64


def pack_steps(steps: NDArray[np.int64]) -> Bytes:
    """Return whole numbers (N, C) as planes of bytes (B, C, N): differences down the rows, small ones first.

    Rows that follow each other along a space-filling curve differ little, so that all but one or two planes are almost empty.
    """
    difference = np.diff(steps, axis=0, prepend=0)
    positive = (difference << 1) ^ (difference >> 63)
    planes = max(1, (int(positive.max(initial=0)).bit_length() + 7) // 8)
    split = np.ascontiguousarray(positive.T).astype("<u8")[..., None].view(np.uint8)
    return np.ascontiguousarray(split[..., :planes].transpose(2, 0, 1))


def unpack_steps(planes: Bytes) -> NDArray[np.int64]:
    """Undo `pack_steps`."""
    positive = np.zeros(planes.shape[1:], np.int64)
    for k, plane in enumerate(planes):
        if k == 0 or plane.any():
            positive |= plane.astype(np.int64) << (8 * k)
    difference = (positive >> 1) ^ -(positive & 1)
    return np.cumsum(difference, axis=1, out=difference).T


def pack_colors(colors: Bytes, levels: int) -> Bytes:
    """Return colours (..., 3) as planes (3, ...) of `levels` steps: green, and how far red and blue are from it (modulo 256)."""
    red, green, blue = np.moveaxis((colors.astype(np.uint16) * (levels - 1) + 127) // 255, -1, 0).astype(np.uint8)
    return np.stack((green, red - green, blue - green))


def unpack_colors(planes: Bytes, levels: int) -> Bytes:
    """Undo `pack_colors` but for the rounding."""
    green, red, blue = planes
    table = np.zeros(256, np.uint8)
    table[:levels] = (np.arange(levels) * 255 + (levels - 1) // 2) // (levels - 1)
    return np.ascontiguousarray(np.moveaxis(table[np.stack((red + green, green, blue + green))], 0, -1))


def row_differences(planes: Bytes) -> Bytes:
    """Return how each byte of (..., N) differs from the one before it, modulo 256."""
    return np.diff(planes, axis=-1, prepend=np.uint8(0))


def row_sums(differences: Bytes) -> Bytes:
    """Undo `row_differences`."""
    return np.cumsum(differences, axis=-1, dtype=np.uint8)
