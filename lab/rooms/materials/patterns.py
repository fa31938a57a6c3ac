"""Painted materials (wood, tiles, bricks, plaster, wallpaper, fabric, carpets), each drawn from a random generator."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.lab.rooms.materials.texture import Color, Texture

Rng = np.random.Generator
_TEXEL_M = 0.006


def noise(rng: Rng, height: int, width: int, cell_rows: int, cell_columns: int) -> NDArray[np.float32]:
    """Return smooth noise (height, width) in about −1..1 that wraps, with the given number of cells along each axis."""
    cells = rng.uniform(-1, 1, (max(1, cell_rows), max(1, cell_columns))).astype(np.float32)
    padded = np.pad(cells, 2, mode="wrap")
    box = (2, 2, 2 + cells.shape[1], 2 + cells.shape[0])
    enlarged = Image.fromarray(padded).resize((width, height), Image.Resampling.BICUBIC, box=box)
    return np.asarray(enlarged, np.float32)


def finished(color: NDArray[np.floating], size_m: tuple[float, float]) -> Texture:
    """Return a Texture of sRGB values (H, W, 3) in 0..1."""
    return Texture((np.clip(color, 0, 1) * 255 + 0.5).astype(np.uint8), size_m)


def plaster(rng: Rng, color: Color, size_m: tuple[float, float], strength: float = 1.0) -> Texture:
    """Paint a painted wall: large soft stains and a fine grain."""
    height, width = _texels(size_m, 0.02)
    stains = noise(rng, height, width, round(size_m[1] * 1.5), round(size_m[0] * 1.5)) * 0.018
    grain = rng.normal(0, 0.008, (height, width))
    return finished(np.asarray(color) + strength * (stains + grain)[..., None], size_m)


def planks(rng: Rng, color: Color, size_m: tuple[float, float], plank_m: tuple[float, float] = (1.2, 0.16)) -> Texture:
    """Paint floor boards along u, each with its own tone, grain and joints."""
    height, width = _texels(size_m, 0.008)
    row = (np.arange(height) * (size_m[1] / height / plank_m[1])).astype(int)
    num_rows = row.max() + 1
    shift = rng.uniform(0, plank_m[0], num_rows)[row]
    along = (np.arange(width) * size_m[0] / width)[None] + shift[:, None]
    column = (along / plank_m[0]).astype(int)
    tones = rng.normal(0, 0.055, (num_rows, column.max() + 1))
    warmth = rng.normal(0, 0.02, tones.shape)
    here = row[:, None], column
    grain = noise(rng, height, width, height // 2, max(2, width // 40)) * 0.045
    knots = noise(rng, height, width, height // 12, max(2, width // 50)) * 0.03
    shade = tones[here] + grain + knots
    joint = (np.diff(row, prepend=row[0]) > 0)[:, None] | (np.diff(column, axis=1, prepend=column[:, :1]) > 0)
    tint = np.stack((shade + warmth[here], shade, shade - warmth[here]), -1)
    return finished((np.asarray(color) + tint) * np.where(joint, 0.55, 1.0)[..., None], size_m)


def wood(rng: Rng, color: Color, size_m: tuple[float, float] = (1.0, 1.0)) -> Texture:
    """Paint furniture wood with the grain along v."""
    height, width = _texels(size_m)
    x = np.linspace(0, size_m[0], width)[None]
    bend = noise(rng, height, width, 3, 4) * 0.05
    rings = np.sin((x + bend) * rng.uniform(60, 140)) * 0.035
    grain = noise(rng, height, width, 5, width // 2) * 0.035
    return finished(np.asarray(color) * (1 + rings + grain)[..., None], size_m)


def tiles(
    rng: Rng, color: Color, second: Color, size_m: tuple[float, float], tile_m: float, layout: str = "grid"
) -> Texture:
    """Paint square tiles with grout; layout "checker" alternates two colors, "mosaic" draws lots."""
    height, width = _texels(size_m, 0.008)
    y, x = np.arange(height)[:, None] * size_m[1] / height / tile_m, np.arange(width)[None] * size_m[0] / width / tile_m
    row, column = np.broadcast_arrays(y.astype(int), x.astype(int))
    tone = rng.normal(0, 0.02, (row.max() + 1, column.max() + 1))[row, column]
    lot = rng.random((row.max() + 1, column.max() + 1))[row, column]
    other = {"grid": lot < 0, "checker": (row + column) % 2 == 1, "mosaic": lot < 0.35}[layout]
    base = np.where(other[..., None], np.asarray(second), np.asarray(color)) + tone[..., None]
    base = base + (noise(rng, height, width, height // 10, width // 10) * 0.02)[..., None]
    edge = 0.006 / tile_m
    grout = (y % 1 < edge) | (x % 1 < edge)
    return finished(np.where(grout[..., None], 0.62, base), size_m)


def bricks(rng: Rng, color: Color, size_m: tuple[float, float] = (2.4, 2.4)) -> Texture:
    """Paint a brick wall in running bond."""
    height, width = _texels(size_m, 0.008)
    y = np.arange(height) * size_m[1] / height / 0.075
    row = y.astype(int)
    x = np.arange(width)[None] * size_m[0] / width / 0.24 + (row % 2 * 0.5)[:, None]
    column = x.astype(int)
    tone = rng.normal(0, 0.06, (row.max() + 1, column.max() + 1))[row[:, None], column]
    rough = noise(rng, height, width, height // 4, width // 4) * 0.04
    face = np.asarray(color) * (1 + 1.4 * (tone + rough))[..., None]
    mortar = ((y % 1 < 0.14)[:, None]) | (x % 1 < 0.045)
    return finished(np.where(mortar[..., None], np.float32(0.68) + rough[..., None], face), size_m)


def wallpaper(rng: Rng, color: Color, second: Color, size_m: tuple[float, float]) -> Texture:
    """Paint wallpaper with stripes, dots, leaves or diamonds, chosen by lot, over slightly uneven paper."""
    height, width = _texels(size_m, 0.01)
    y, x = np.arange(height)[:, None] * size_m[1] / height, np.arange(width)[None] * size_m[0] / width
    period = rng.uniform(0.14, 0.34)
    cell_x, cell_y = (x / period) % 1 - 0.5, (y / period + (x / period).astype(int) % 2 * 0.5) % 1 - 0.5
    kind = rng.integers(4)
    if kind == 0:
        share = ((x / period) % 1 < rng.uniform(0.2, 0.5)) & (y >= 0)
    elif kind == 1:
        share = cell_x**2 + cell_y**2 < rng.uniform(0.03, 0.08)
    elif kind == 2:
        share = np.abs(cell_x) < 0.3 * np.cos(cell_y * np.pi) * (0.6 + 0.4 * np.sin(cell_y * 25))
    else:
        share = np.abs(np.abs(cell_x) + np.abs(cell_y) - 0.38) < 0.06
    uneven = noise(rng, height, width, round(size_m[1] * 2), round(size_m[0] * 2)) * 0.015
    return finished(np.where(share[..., None], np.asarray(second), np.asarray(color)) + uneven[..., None], size_m)


def fabric(rng: Rng, color: Color, size_m: tuple[float, float] = (0.8, 0.8), second: Color | None = None) -> Texture:
    """Paint woven cloth; with a second color, striped or checked."""
    height, width = _texels(size_m)
    weave = rng.normal(0, 0.025, (height, width)) + noise(rng, height, width, 6, 6) * 0.025
    base = np.broadcast_to(np.asarray(color, np.float64), (height, width, 3))
    if second is not None:
        period = size_m[0] / rng.integers(3, 8) / size_m[0] * width
        stripe_x = (np.arange(width) / period) % 1 < 0.4
        stripe_y = (np.arange(height) / period) % 1 < 0.4
        both = stripe_x[None] & (stripe_y[:, None] | (rng.random() < 0.5))
        base = np.where(both[..., None], np.asarray(second), base)
    return finished(base + weave[..., None], size_m)


def carpet(rng: Rng, colors: Sequence[Color], size_m: tuple[float, float]) -> Texture:
    """Paint a rug as large as the surface: nested borders and a field of stripes, diamonds or a medallion."""
    height, width = _texels(size_m, 0.01)
    y, x = np.linspace(0, size_m[1], height)[:, None], np.linspace(0, size_m[0], width)[None]
    border = np.minimum(np.minimum(x, size_m[0] - x), np.minimum(y, size_m[1] - y))
    palette = np.asarray(colors)
    a, b = x - size_m[0] / 2, y - size_m[1] / 2
    period = rng.uniform(0.15, 0.45)
    kind = rng.integers(4)
    if kind == 0:
        field = (np.abs(a) / period + np.abs(b) / period).astype(int)
    elif kind == 1:
        field = (np.hypot(a, b) / period * (1 + 0.15 * np.cos(8 * np.arctan2(b, a)))).astype(int)
    elif kind == 2:
        field = np.broadcast_to((x / period).astype(int), border.shape)
    else:
        field = (x / period).astype(int) * 7 + (y / period).astype(int) * 3
    band = (border / rng.uniform(0.05, 0.12)).astype(int)
    index = np.where(band < 3, band + 1, field) % len(palette)
    pile = rng.normal(0, 0.03, (height, width)) + noise(rng, height, width, 8, 8) * 0.02
    return finished(palette[index] + pile[..., None], size_m)


def concrete(rng: Rng, color: Color, size_m: tuple[float, float]) -> Texture:
    """Paint concrete, asphalt or stone: noise at several scales."""
    height, width = _texels(size_m, 0.012)
    coarse = noise(rng, height, width, round(size_m[1] * 1.2), round(size_m[0] * 1.2)) * 0.05
    middle = noise(rng, height, width, round(size_m[1] * 8), round(size_m[0] * 8)) * 0.03
    return finished(np.asarray(color) + (coarse + middle + rng.normal(0, 0.025, (height, width)))[..., None], size_m)


def _texels(size_m: tuple[float, float], texel_m: float = _TEXEL_M) -> tuple[int, int]:
    return max(4, round(size_m[1] / texel_m)), max(4, round(size_m[0] / texel_m))
