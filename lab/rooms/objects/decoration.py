"""Smaller things: rugs, pictures, plants, lamps, curtains, radiators, mirrors and people."""

import numpy as np

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style, pick
from panoloc.lab.rooms.materials.texture import plain
from panoloc.lab.rooms.objects.furniture import item
from panoloc.lab.rooms.objects.objects import Item, Light, Piece
from panoloc.lab.rooms.objects.solids import box, cylinder, ellipsoid, quad


def rug(rng: Rng, style: Style, max_size_m: tuple[float, float]) -> Item:
    """Return a patterned rug lying on the floor, at most `max_size_m` large."""
    w, d = min(max_size_m[0], rng.uniform(1.2, 3.0)), min(max_size_m[1], rng.uniform(1.0, 2.4))
    colors = [pick(rng, style.fabrics), pick(rng, style.accents), pick(rng, style.walls), pick(rng, style.fabrics)]
    sides = plain(colors[1])
    parts = box(
        (w, d, 0.012), {"sides": sides, "top": patterns.carpet(rng, colors, (w, d))}, (0, d / 2, 0), skip=("bottom",)
    )
    # Texture coordinates of a box's top start at its corner, which is where the carpet's image starts.
    return item("rug", "rug", parts, (w, d, 0.012), "floor")


def wall_picture(rng: Rng, style: Style) -> Item:
    """Return a framed picture with its middle at the height of the eyes."""
    del style
    w, h = rng.uniform(0.35, 1.3), rng.uniform(0.35, 1.0)
    bottom = rng.uniform(1.5, 1.75) - h / 2
    parts = box(
        (w, 0.03, h), {"sides": plain((0.2, 0.18, 0.15)), "front": artwork.picture(rng, (w, h))}, (0, 0.015, bottom)
    )
    return item("picture", "picture", parts, (w, 0.03, h), "hung")


def plant(rng: Rng, style: Style) -> Item:
    """Return a pot plant of several leafy blobs."""
    pot = plain(pick(rng, (*style.accents, (0.66, 0.40, 0.28), (0.9, 0.9, 0.88))))
    radius, height = rng.uniform(0.14, 0.22), rng.uniform(0.22, 0.4)
    green = artwork.foliage(rng, np.array([0.22, 0.42, 0.18]) * rng.uniform(0.7, 1.3))
    crown = rng.uniform(0.7, 1.5)
    leaves = cylinder(0.02, crown - height, plain((0.36, 0.28, 0.18)), (0, radius, height))
    for _ in range(rng.integers(5, 9)):
        size = rng.uniform(0.10, 0.22)
        spot = (rng.normal(0, 0.13), radius + rng.normal(0, 0.13), rng.uniform(height + 0.15, crown + 0.1))
        leaves += ellipsoid((size, size, size * rng.uniform(0.5, 1.2)), green, spot)
    parts = cylinder(radius * 0.75, height, pot, (0, radius, 0), top_radius=radius)
    return item("plant", "plant", [*parts, *leaves], (2 * radius + 0.2, 2 * radius + 0.2, crown), "corner")


def floor_lamp(rng: Rng, style: Style) -> Item:
    """Return a standing lamp that gives light."""
    dark = plain((0.12, 0.11, 0.10))
    height = rng.uniform(1.4, 1.8)
    parts = cylinder(0.14, 0.03, dark, (0, 0.2, 0)) + cylinder(0.015, height, dark, (0, 0.2, 0.03))
    shade = cylinder(0.19, 0.28, plain(style.lamp), (0, 0.2, height - 0.1), top_radius=0.13, glow=0.95)
    ring = [(0.26 * np.cos(a), 0.2 + 0.26 * np.sin(a), height + dz) for a in (0.0, 2.1, 4.2) for dz in (-0.2, 0.3)]
    light = Light(np.array(ring), np.asarray(style.lamp) * 0.8)
    return Item("floor_lamp", (Piece("lamp", tuple(parts + shade)),), (0.4, 0.4, height + 0.2), "corner", (light,))


def ceiling_lamp(rng: Rng, style: Style, power: float) -> Item:
    """Return a hanging or flat ceiling lamp; its origin is on the ceiling."""
    drop = float(rng.choice([0.08, 0.08, 0.35, 0.6]))
    radius = rng.uniform(0.14, 0.3)
    parts = cylinder(radius, 0.07, plain(style.lamp), (0, 0, -drop), top_radius=radius * 0.9, glow=1.0)
    if drop > 0.1:
        parts += cylinder(0.008, drop - 0.07, plain((0.1, 0.1, 0.1)), (0, 0, -drop + 0.07), num_sides=6)
    below = [(0.12 * np.cos(a), 0.12 * np.sin(a), -drop - 0.06) for a in (0.3, 1.9, 3.4, 5.0)]
    around = [((radius + 0.05) * np.cos(a), (radius + 0.05) * np.sin(a), -drop + 0.03) for a in (0.0, 1.6, 3.1, 4.7)]
    lights = (
        Light(np.array(below), np.asarray(style.lamp) * power, np.array([0.0, 0, -1])),
        Light(np.array(around), np.asarray(style.lamp) * power * 0.3),
    )
    return Item(
        "ceiling_lamp", (Piece("lamp", tuple(parts)),), (2 * radius, 2 * radius, drop), "ceiling", lights, fixture=True
    )


def radiator(rng: Rng, width_m: float) -> Item:
    """Return a ribbed radiator."""
    tone = rng.uniform(0.84, 0.93)
    ribs = np.full((4, 16, 3), tone)
    ribs[:, :3], ribs[:, 3:5] = tone * 0.62, tone * 0.85
    texture = patterns.finished(ribs, (0.08, 0.5))
    parts = box((width_m, 0.09, 0.5), {"sides": texture, "top": plain((tone, tone, tone))}, (0, 0.065, 0.14))
    return item("radiator", "radiator", parts, (width_m, 0.12, 0.64), "wall", fixture=True)


def curtain(rng: Rng, style: Style, height_m: float) -> Item:
    """Return one wavy curtain hanging from `height_m` to just above the floor."""
    width, folds = rng.uniform(0.35, 0.55), 7
    cloth = patterns.fabric(
        rng, pick(rng, style.fabrics), second=pick(rng, style.accents) if rng.random() < 0.3 else None
    )
    x = np.linspace(width / 2, -width / 2, folds + 1)
    y = 0.06 + 0.035 * (np.arange(folds + 1) % 2)
    parts = []
    for k in range(folds):
        edge = (x[k + 1] - x[k], y[k + 1] - y[k], 0)
        parts.append(quad((x[k], y[k], 0.03), edge, (0, 0, height_m - 0.03), cloth, uv_start=(0.06 * k, 0)))
    return item("curtain", "curtain", parts, (width, 0.12, height_m), "wall")


def person(rng: Rng) -> Item:
    """Return a standing person."""
    skin = plain(np.array(artwork.random_rgb(rng, 0.45, (0.45, 0.95), hue=0.06)) / 255)
    shirt = patterns.fabric(rng, np.array(artwork.random_rgb(rng, 0.9, (0.15, 0.9))) / 255)
    trousers = patterns.fabric(rng, np.array(artwork.random_rgb(rng, 0.6, (0.1, 0.5))) / 255)
    hair = plain(np.array(artwork.random_rgb(rng, 0.6, (0.05, 0.5), hue=0.07)) / 255)
    scale = rng.uniform(0.92, 1.08)
    parts = []
    for x in (-0.1, 0.1):
        parts += cylinder(0.07, 0.85, trousers, (x, 0.15, 0), top_radius=0.09)
        parts += cylinder(0.04, 0.6, shirt, (2.4 * x, 0.15, 0.78), top_radius=0.055)
        parts += ellipsoid((0.045, 0.045, 0.08), skin, (2.4 * x, 0.15, 0.74))
    parts += ellipsoid((0.21, 0.13, 0.34), shirt, (0, 0.15, 1.14))
    parts += ellipsoid((0.1, 0.11, 0.14), skin, (0, 0.16, 1.6)) + ellipsoid((0.11, 0.11, 0.12), hair, (0, 0.135, 1.65))
    grown = [type(part)(part.vertices * scale, part.triangles, part.uv_m, part.texture) for part in parts]
    return item("person", "person", grown, (0.6, 0.35, 1.75 * scale), "middle")
