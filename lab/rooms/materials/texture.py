"""Textures as small bitmaps with a size in metres, and their atlas with mip levels, looked up for all hits at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# sRGB in 0..1.
Color = Sequence[float] | NDArray[np.floating]
_NUM_LEVELS = 7
_LINEAR = ((np.arange(256) / 255) ** 2.2).astype(np.float32)
"""Linear reflectance in 0..1 of sRGB bytes (gamma 2.2)."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A bitmap that repeats over a surface.

    pixels: (H, W, 3) uint8, sRGB; row 0 is the top. size_m: width and height of one repetition in metres.
    """

    pixels: NDArray[np.uint8]
    size_m: tuple[float, float]

    @property
    def mean_albedo(self) -> NDArray[np.float64]:
        """Return the mean linear reflectance (3,)."""
        return np.asarray(_LINEAR[self.pixels[::2, ::2]].mean((0, 1)), np.float64)


def plain(color: Color) -> Texture:
    """Return a texture of one sRGB color, components in 0..1."""
    return Texture(np.full((1, 1, 3), np.round(np.clip(color, 0, 1) * np.float64(255)), np.uint8), (1.0, 1.0))


class TextureAtlas:
    """All textures of a scene with their mip levels in one flat array, so that one gather serves every hit."""

    def __init__(self, textures: Sequence[Texture]) -> None:
        self.mean_albedo = np.array([texture.mean_albedo for texture in textures])
        self._metres = np.array([texture.size_m for texture in textures], np.float32)
        self._starts = np.zeros((len(textures), _NUM_LEVELS), np.int64)
        self._sizes = np.zeros((len(textures), _NUM_LEVELS, 2), np.int64)
        blocks: list[NDArray[np.uint8]] = []
        total = 0
        for number, texture in enumerate(textures):
            pixels = texture.pixels
            for level in range(_NUM_LEVELS):
                self._starts[number, level] = total
                self._sizes[number, level] = pixels.shape[1], pixels.shape[0]
                blocks.append(pixels.reshape(-1, 3))
                total += len(blocks[-1])
                pixels = _halved(pixels)
        self._texels = np.concatenate(blocks)
        finest = self._metres / self._sizes[:, 0]
        self._texel_m = np.maximum(finest.max(axis=1), 1e-6)

    def sample(
        self, texture: NDArray[np.int64], uv_m: NDArray[np.float32], footprint_m: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return linear reflectance (N, 3) at `uv_m` (N, 2), filtered over about `footprint_m` (N,) metres."""
        level = np.log2(np.maximum(footprint_m / self._texel_m[texture], 1e-6))
        level = np.clip(np.round(level), 0, _NUM_LEVELS - 1).astype(np.int64)
        size = self._sizes[texture, level]
        start = self._starts[texture, level]
        metres = self._metres[texture]
        x = uv_m[:, 0] / metres[:, 0] * size[:, 0] - 0.5
        y = -uv_m[:, 1] / metres[:, 1] * size[:, 1] - 0.5
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        right_share, bottom_share = (x - left)[:, None], (y - top)[:, None]
        columns = left % size[:, 0], (left + 1) % size[:, 0]
        rows = start + top % size[:, 1] * size[:, 0], start + (top + 1) % size[:, 1] * size[:, 0]
        upper = self._linear(rows[0] + columns[0], rows[0] + columns[1], right_share)
        lower = self._linear(rows[1] + columns[0], rows[1] + columns[1], right_share)
        return np.asarray(upper + (lower - upper) * bottom_share, np.float32)

    def _linear(
        self, first: NDArray[np.int64], second: NDArray[np.int64], share: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        start, end = _LINEAR[self._texels[first]], _LINEAR[self._texels[second]]
        return np.asarray(start + (end - start) * share, np.float32)


def _halved(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = pixels.shape[:2]
    if width > 1:
        even = pixels[:, : width // 2 * 2].astype(np.uint16)
        pixels = ((even[:, 0::2] + even[:, 1::2] + 1) // 2).astype(np.uint8)
    if height > 1:
        even = pixels[: height // 2 * 2].astype(np.uint16)
        pixels = ((even[0::2] + even[1::2] + 1) // 2).astype(np.uint8)
    return pixels
