"""Kitchen and bathroom fittings, and the small things on bare walls."""

import numpy as np

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style, pick
from panoloc.lab.rooms.materials.texture import Color, Texture, plain
from panoloc.lab.rooms.objects.furniture import item
from panoloc.lab.rooms.objects.objects import Item, Piece
from panoloc.lab.rooms.objects.solids import Part, box, cylinder, quad


def kitchen(rng: Rng, style: Style) -> Item:
    """Return a kitchen counter with oven, sink and wall cupboards."""
    units = int(rng.integers(3, 6))
    w, d, h = 0.6 * units, 0.62, 0.91
    color = pick(rng, (*style.walls, *style.woods, *style.accents))
    carcass, worktop = plain(color), patterns.concrete(rng, pick(rng, (*style.woods, (0.3, 0.3, 0.32))), (w, d))
    parts = box(
        (w, d - 0.03, h - 0.04), {"sides": carcass, "front": _fronts(rng, color, units, (w, h - 0.04))}, (0, d / 2, 0)
    )
    parts += box((w + 0.02, d, 0.04), worktop, (0, d / 2, h - 0.04))
    tiles = patterns.tiles(
        rng, (0.88, 0.88, 0.86), pick(rng, style.accents), (w, 0.5), 0.125, "mosaic" if rng.random() < 0.5 else "grid"
    )
    parts.append(quad((w / 2, 0.005, h), (-w, 0, 0), (0, 0, 0.5), tiles))
    above = max(2, units - int(rng.integers(0, 2)))
    cupboard = {"sides": carcass, "front": _fronts(rng, color, above, (0.6 * above, 0.7))}
    parts += box((0.6 * above, 0.34, 0.7), cupboard, ((above - units) * 0.3, 0.17, h + 0.5))
    x = -w / 2 + 0.3 + 0.6 * int(rng.integers(units))
    dark, steel = plain((0.07, 0.07, 0.08)), plain((0.6, 0.61, 0.63))
    machines = box((0.56, 0.02, 0.58), {"sides": dark, "front": _oven(rng)}, (x, d + 0.0, 0.2))
    machines += box((0.54, 0.5, 0.006), dark, (x, d / 2, h))
    sink = -w / 2 + 0.3 + 0.6 * int(rng.integers(units))
    machines += box((0.5, 0.4, 0.01), steel, (sink, d / 2, h)) + cylinder(0.015, 0.25, steel, (sink, 0.1, h))
    for _ in range(rng.integers(2, 6)):
        paint = plain(np.array(artwork.random_rgb(rng, 0.8, (0.2, 1))) / 255)
        spot = (rng.uniform(-0.45, 0.45) * w, rng.uniform(0.1, 0.3), h + 0.006)
        machines += cylinder(rng.uniform(0.03, 0.08), rng.uniform(0.08, 0.3), paint, spot)
    return item(
        "kitchen",
        "cabinet",
        parts,
        (w + 0.02, d + 0.03, 2.1),
        "wall",
        Piece("appliance", tuple(machines)),
        fixture=True,
    )


def bathtub(rng: Rng, style: Style) -> Item:
    """Return a bathtub in front of tiles."""
    w, d, h = rng.uniform(1.5, 1.7), 0.75, 0.58
    white = plain((0.94, 0.94, 0.94))
    parts = box(
        (w, d, h), {"sides": plain(pick(rng, ((0.93, 0.93, 0.93), *style.accents)))}, (0, d / 2, 0), skip=("top",)
    )
    for x, y, a, b in (
        (0, 0.04, w, 0.08),
        (0, d - 0.04, w, 0.08),
        (w / 2 - 0.05, d / 2, 0.1, d),
        (0.05 - w / 2, d / 2, 0.1, d),
    ):
        parts += box((a, b, 0.02), white, (x, y, h))
    parts.append(quad((-w / 2, 0.0, h - 0.01), (w, 0, 0), (0, d, 0), plain((0.82, 0.84, 0.86))))
    size = (w, 1.4)
    wall = patterns.tiles(rng, (0.90, 0.91, 0.90), pick(rng, style.accents), size, 0.14, "mosaic")
    parts.append(quad((w / 2, 0.004, h), (-w, 0, 0), (0, 0, size[1]), wall))
    return item("bathtub", "appliance", parts, (w, d, 2.0), "wall", fixture=True)


def washbasin(rng: Rng, style: Style) -> Item:
    """Return a washbasin with a cupboard below and a mirror cupboard above."""
    w = rng.uniform(0.55, 1.0)
    white, steel = plain((0.94, 0.94, 0.94)), plain((0.62, 0.63, 0.65))
    color = pick(rng, style.woods)
    parts = box((w, 0.42, 0.6), {"sides": plain(color), "front": _fronts(rng, color, 2, (w, 0.6))}, (0, 0.22, 0.2))
    parts += box((w + 0.04, 0.48, 0.1), white, (0, 0.24, 0.8)) + cylinder(0.015, 0.2, steel, (0, 0.08, 0.9))
    parts += box((w, 0.12, 0.65), {"sides": white, "front": plain((0.68, 0.74, 0.76))}, (0, 0.06, 1.3))
    return item("washbasin", "cabinet", parts, (w + 0.04, 0.5, 1.95), "wall", fixture=True)


def toilet(rng: Rng, style: Style) -> Item:
    """Return a toilet with its cistern."""
    del style
    white = plain(np.array([0.95, 0.95, 0.94]) * rng.uniform(0.92, 1.0))
    parts = box((0.4, 0.18, 0.38), white, (0, 0.09, 0.42)) + box((0.36, 0.3, 0.42), white, (0, 0.2, 0))
    parts += cylinder(0.14, 0.38, white, (0, 0.42, 0), top_radius=0.2)
    parts += cylinder(0.2, 0.04, plain((0.85, 0.85, 0.84)), (0, 0.42, 0.38))
    return item("toilet", "appliance", parts, (0.42, 0.64, 0.8), "wall", fixture=True)


def socket(rng: Rng, kind: str) -> Item:
    """Return a light switch (kind "switch"), a power socket, or a cable duct."""
    white, grey = plain((0.95, 0.95, 0.94)), plain((0.35, 0.35, 0.35))
    if kind == "duct":
        size = (0.06, 0.03, rng.uniform(1.0, 2.0))
        return item("duct", "trim", box(size, plain((0.85, 0.85, 0.83)), (0, 0.015, 0.1)), size, "hung")
    height = 1.08 if kind == "switch" else 0.3
    width = 0.085 * int(rng.integers(1, 4))
    parts: list[Part] = box((width, 0.012, 0.085), white, (0, 0.006, height))
    for x in np.arange(-width / 2 + 0.0425, width / 2, 0.085):
        mark = (0.05, 0.004, 0.05) if kind == "switch" else (0.03, 0.004, 0.012)
        parts += box(mark, white if kind == "switch" else grey, (float(x), 0.014, height + 0.0425 - mark[2] / 2))
    return item(kind, "trim", parts, (width, 0.02, height + 0.1), "hung", fixture=True)


def _fronts(rng: Rng, color: Color, units: int, size_m: tuple[float, float]) -> Texture:
    """Paint a row of cupboard fronts with handles."""
    pixels = patterns.wood(rng, color, size_m).pixels.copy()
    height, width = pixels.shape[:2]
    for number in range(units):
        left, right = round(number * width / units), round((number + 1) * width / units)
        pixels[:, left : left + 2] //= 3
        rows = [0.0, 0.25, 0.5, 0.75] if rng.random() < 0.3 else [0.0]
        for row in rows:
            top = int(row * height)
            pixels[top : top + 2, left:right] //= 3
            bar = top + max(4, int(0.05 * height))
            pixels[bar : bar + 3, left + (right - left) // 3 : right - (right - left) // 3] = (176, 174, 168)
    return Texture(pixels, size_m)


def _oven(rng: Rng) -> Texture:
    pixels = np.full((116, 112, 3), 28, np.uint8)
    pixels[:22] = 150
    for x in range(14, 100, 22):
        pixels[6:16, x : x + 9] = rng.integers(30, 90)
    pixels[30:36, 14:98] = 170
    pixels[46:104, 14:98] = (60, 52, 46)
    return Texture(pixels, (0.56, 0.58))
