"""Families of interior styles: palettes, materials and density of furniture. Held-out families test generalization."""

from dataclasses import dataclass

import numpy as np

from panoloc.lab.rooms.materials import patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.texture import Color, Texture


@dataclass(frozen=True)
class Style:
    """What a family of rooms is made of; colors are sRGB in 0..1, `density` scales the number of things."""

    walls: tuple[Color, ...]
    accents: tuple[Color, ...]
    woods: tuple[Color, ...]
    fabrics: tuple[Color, ...]
    floors: tuple[str, ...]
    wall_finishes: tuple[str, ...]
    lamp: Color
    density: float


STYLES: dict[str, Style] = {
    "nordic": Style(
        walls=((0.90, 0.89, 0.86), (0.80, 0.84, 0.85), (0.87, 0.83, 0.78)),
        accents=((0.36, 0.47, 0.52), (0.72, 0.55, 0.45), (0.48, 0.55, 0.45)),
        woods=((0.78, 0.64, 0.47), (0.85, 0.75, 0.60), (0.62, 0.47, 0.33)),
        fabrics=((0.55, 0.58, 0.60), (0.76, 0.72, 0.64), (0.30, 0.40, 0.46), (0.70, 0.45, 0.38)),
        floors=("planks", "planks", "tiles"),
        wall_finishes=("plaster", "plaster", "accent"),
        lamp=(1.0, 0.95, 0.86),
        density=1.0,
    ),
    "classic": Style(
        walls=((0.82, 0.74, 0.60), (0.70, 0.74, 0.64), (0.80, 0.70, 0.66)),
        accents=((0.50, 0.20, 0.18), (0.22, 0.34, 0.28), (0.62, 0.50, 0.28)),
        woods=((0.42, 0.25, 0.15), (0.50, 0.32, 0.18), (0.34, 0.20, 0.13)),
        fabrics=((0.48, 0.16, 0.16), (0.20, 0.32, 0.26), (0.66, 0.54, 0.34), (0.26, 0.26, 0.42)),
        floors=("planks", "checker"),
        wall_finishes=("wallpaper", "plaster", "wallpaper"),
        lamp=(1.0, 0.88, 0.70),
        density=1.2,
    ),
    "office": Style(
        walls=((0.88, 0.88, 0.88), (0.78, 0.81, 0.84), (0.86, 0.86, 0.80)),
        accents=((0.16, 0.36, 0.60), (0.82, 0.46, 0.14), (0.30, 0.55, 0.36)),
        woods=((0.86, 0.84, 0.80), (0.70, 0.62, 0.52), (0.48, 0.48, 0.50)),
        fabrics=((0.16, 0.18, 0.22), (0.20, 0.36, 0.56), (0.46, 0.48, 0.50), (0.72, 0.32, 0.16)),
        floors=("carpet_tiles", "tiles", "concrete"),
        wall_finishes=("plaster", "plaster", "accent"),
        lamp=(0.96, 0.98, 1.0),
        density=1.1,
    ),
    "rustic": Style(
        walls=((0.86, 0.80, 0.68), (0.78, 0.66, 0.52), (0.88, 0.85, 0.78)),
        accents=((0.60, 0.32, 0.20), (0.45, 0.48, 0.28), (0.30, 0.38, 0.46)),
        woods=((0.56, 0.38, 0.22), (0.46, 0.30, 0.18), (0.66, 0.48, 0.30)),
        fabrics=((0.62, 0.50, 0.34), (0.42, 0.45, 0.30), (0.58, 0.26, 0.18), (0.80, 0.74, 0.62)),
        floors=("planks", "mosaic"),
        wall_finishes=("plaster", "bricks", "boards"),
        lamp=(1.0, 0.86, 0.66),
        density=1.0,
    ),
    "industrial": Style(
        walls=((0.66, 0.65, 0.63), (0.54, 0.54, 0.55), (0.76, 0.74, 0.72)),
        accents=((0.60, 0.28, 0.18), (0.20, 0.24, 0.26), (0.80, 0.64, 0.20)),
        woods=((0.40, 0.30, 0.22), (0.30, 0.28, 0.27), (0.55, 0.42, 0.30)),
        fabrics=((0.30, 0.22, 0.16), (0.22, 0.24, 0.26), (0.56, 0.40, 0.24), (0.42, 0.44, 0.46)),
        floors=("concrete", "planks"),
        wall_finishes=("bricks", "concrete", "plaster"),
        lamp=(1.0, 0.90, 0.74),
        density=0.8,
    ),
    "colorful": Style(
        walls=((0.95, 0.82, 0.46), (0.56, 0.78, 0.80), (0.90, 0.66, 0.62), (0.72, 0.82, 0.58)),
        accents=((0.82, 0.26, 0.32), (0.16, 0.42, 0.62), (0.50, 0.28, 0.56)),
        woods=((0.84, 0.70, 0.50), (0.92, 0.90, 0.86), (0.30, 0.52, 0.56)),
        fabrics=((0.86, 0.34, 0.26), (0.20, 0.48, 0.66), (0.92, 0.74, 0.22), (0.44, 0.28, 0.54), (0.36, 0.60, 0.34)),
        floors=("planks", "checker", "mosaic"),
        wall_finishes=("plaster", "accent", "wallpaper"),
        lamp=(1.0, 0.94, 0.84),
        density=1.2,
    ),
}


def pick(rng: Rng, colors: tuple[Color, ...], spread: float = 0.03) -> Color:
    """Draw one of the colors, slightly varied."""
    lightness, tint = rng.normal(0, spread), rng.normal(0, spread / 3, 3)
    return np.clip(np.asarray(colors[rng.integers(len(colors))]) + lightness + tint, 0.03, 0.97)


def floor_texture(rng: Rng, style: Style, size_m: tuple[float, float]) -> Texture:
    """Paint the floor of a room of the given size."""
    kind = style.floors[rng.integers(len(style.floors))]
    if kind == "planks":
        return patterns.planks(rng, pick(rng, style.woods), size_m, (rng.uniform(0.7, 1.6), rng.uniform(0.09, 0.2)))
    if kind == "concrete":
        return patterns.concrete(rng, (0.52, 0.51, 0.49), size_m)
    if kind == "carpet_tiles":
        return patterns.tiles(rng, (0.36, 0.38, 0.42), (0.30, 0.33, 0.40), size_m, 0.5, "checker")
    layout = "grid" if kind == "tiles" else kind
    return patterns.tiles(rng, (0.80, 0.78, 0.74), pick(rng, style.accents), size_m, rng.uniform(0.2, 0.5), layout)


def wall_texture(rng: Rng, style: Style, color: Color, size_m: tuple[float, float]) -> Texture:
    """Paint one wall: most walls of a room share its color, some have an accent, paper, bricks or boards."""
    finish = style.wall_finishes[rng.integers(len(style.wall_finishes))] if rng.random() < 0.5 else "plaster"
    if finish == "accent":
        return patterns.plaster(rng, pick(rng, style.accents), size_m)
    if finish == "wallpaper":
        return patterns.wallpaper(rng, color, np.asarray(color) * rng.uniform(0.72, 0.9), size_m)
    if finish == "bricks":
        return patterns.bricks(rng, (0.58, 0.32, 0.24))
    if finish == "boards":
        return patterns.planks(rng, pick(rng, style.woods), size_m, (6.0, 0.14))
    if finish == "concrete":
        return patterns.concrete(rng, (0.58, 0.57, 0.55), size_m)
    return patterns.plaster(rng, color, size_m)
