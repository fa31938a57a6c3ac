"""Furniture that stands on the floor, each piece drawn at random from a style."""

import numpy as np

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style, pick
from panoloc.lab.rooms.materials.texture import plain
from panoloc.lab.rooms.objects.objects import Item, Piece
from panoloc.lab.rooms.objects.solids import Part, box, cylinder, quad


def item(
    name: str,
    label: str,
    parts: list[Part],
    size_m: tuple[float, float, float],
    anchor: str,
    *more: Piece,
    fixture: bool = False,
) -> Item:
    """Return an Item of one main piece and possibly others."""
    return Item(name, (Piece(label, tuple(parts)), *more), size_m, anchor, fixture=fixture)


def table(rng: Rng, style: Style) -> Item:
    """Return a table with four legs, sometimes a cloth, books or a bowl on it."""
    w, d, h = rng.uniform(0.9, 2.0), rng.uniform(0.7, 1.0), rng.uniform(0.70, 0.78)
    timber = patterns.wood(rng, pick(rng, style.woods))
    parts = box((w, d, 0.045), timber, (0, d / 2, h - 0.045))
    for x in (-w / 2 + 0.06, w / 2 - 0.06):
        for y in (0.06, d - 0.06):
            parts += box((0.06, 0.06, h - 0.045), timber, (x, y, 0))
    if rng.random() < 0.4:
        cloth = patterns.fabric(rng, pick(rng, style.fabrics), second=pick(rng, style.walls))
        parts += box((w * 0.4, d * 1.01, 0.008), cloth, (0, d / 2, h), skip=("bottom",))
    clutter: list[Part] = []
    for _ in range(rng.integers(1, 5)):
        spot = (rng.uniform(-0.4, 0.4) * w, d / 2 + rng.uniform(-0.35, 0.35) * d, h + 0.008)
        paint = plain(np.array(artwork.random_rgb(rng, 0.8, (0.2, 1))) / 255)
        if rng.random() < 0.5:
            clutter += box((rng.uniform(0.12, 0.3), rng.uniform(0.1, 0.24), rng.uniform(0.02, 0.12)), paint, spot)
        else:
            clutter += cylinder(
                rng.uniform(0.03, 0.07), rng.uniform(0.06, 0.25), paint, spot, top_radius=rng.uniform(0.03, 0.12)
            )
    return item("table", "table", parts, (w, d, h), "middle", Piece("box", tuple(clutter)))


def chair(rng: Rng, style: Style) -> Item:
    """Return a chair with seat, back and legs."""
    w, d, seat, h = rng.uniform(0.42, 0.5), rng.uniform(0.44, 0.52), rng.uniform(0.43, 0.48), rng.uniform(0.8, 1.0)
    timber = patterns.wood(rng, pick(rng, style.woods))
    cover = patterns.fabric(rng, pick(rng, style.fabrics)) if rng.random() < 0.6 else timber
    parts = box((w, d, 0.06), cover, (0, d / 2, seat - 0.06))
    parts += box((w, 0.05, h - seat - 0.12), cover, (0, 0.025, seat + 0.12))
    for x in (-w / 2 + 0.025, w / 2 - 0.025):
        parts += box((0.04, 0.04, h - 0.02), timber, (x, 0.025, 0))
        parts += box((0.04, 0.04, seat - 0.06), timber, (x, d - 0.03, 0))
    return item("chair", "chair", parts, (w, d, h), "middle")


def sofa(rng: Rng, style: Style) -> Item:
    """Return a sofa or armchair with arms, cushions and a throw pillow or two."""
    w, d, h = rng.choice([0.9, 1.6, 2.1]) + rng.uniform(-0.1, 0.15), rng.uniform(0.82, 0.95), rng.uniform(0.75, 0.9)
    pattern = pick(rng, style.fabrics) if rng.random() < 0.3 else None
    cloth = patterns.fabric(rng, pick(rng, style.fabrics), second=pattern)
    parts = box((w, d, 0.28), cloth, (0, d / 2, 0.08))
    parts += box((w, 0.22, h - 0.36), cloth, (0, 0.11, 0.36))
    for x in (-w / 2 + 0.09, w / 2 - 0.09):
        parts += box((0.18, d, 0.26), cloth, (x, d / 2, 0.36))
    seats = max(1, round((w - 0.36) / 0.7))
    each = (w - 0.36) / seats
    for number in range(seats):
        x = -w / 2 + 0.18 + each * (number + 0.5)
        parts += box((each - 0.02, d - 0.24, 0.12), cloth, (x, 0.22 + (d - 0.24) / 2, 0.36))
    for _ in range(rng.integers(0, 4)):
        pillow = patterns.fabric(rng, pick(rng, style.accents), second=pick(rng, style.fabrics))
        parts += box((0.4, 0.14, 0.36), pillow, (rng.uniform(-0.5, 0.5) * (w - 0.8), 0.3, 0.48))
    return item("sofa", "sofa", parts, (w, d, h), "wall")


def bed(rng: Rng, style: Style) -> Item:
    """Return a bed with headboard, mattress, blanket and pillows."""
    w, d = rng.choice([0.9, 1.4, 1.8]), 2.05
    timber = patterns.wood(rng, pick(rng, style.woods))
    sheet = patterns.fabric(rng, (0.90, 0.89, 0.87))
    blanket = patterns.fabric(
        rng, pick(rng, style.fabrics), (1.2, 1.2), pick(rng, style.accents) if rng.random() < 0.6 else None
    )
    parts = box((w + 0.06, 0.06, rng.uniform(0.8, 1.15)), timber, (0, 0.03, 0))
    parts += box((w + 0.04, d - 0.06, 0.3), timber, (0, d / 2 + 0.03, 0))
    parts += box((w, d - 0.12, 0.2), sheet, (0, d / 2 + 0.03, 0.3))
    parts += box((w + 0.04, d * 0.66, 0.05), blanket, (0, d * 0.66, 0.47))
    for x in (-w / 4, w / 4) if w > 1 else (0.0,):
        parts += box((0.6, 0.38, 0.12), sheet, (x, 0.32, 0.5))
    return item("bed", "bed", parts, (w + 0.06, d, 0.6), "wall")


def wardrobe(rng: Rng, style: Style) -> Item:
    """Return a wardrobe or sideboard with doors and handles."""
    tall = rng.random() < 0.55
    w, d = rng.uniform(0.8, 2.0), rng.uniform(0.4, 0.6)
    h = rng.uniform(1.8, 2.2) if tall else rng.uniform(0.7, 1.0)
    timber = patterns.wood(rng, pick(rng, style.woods))
    front = patterns.wood(
        rng, pick(rng, (*style.woods, *style.accents) if rng.random() < 0.4 else style.woods), (w, h - 0.08)
    )
    pixels = front.pixels.copy()
    doors = max(2, round(w / 0.5))
    for number in range(doors):
        x = int(number / doors * pixels.shape[1])
        pixels[:, x : x + 3] = pixels[:, x : x + 3] // 3
        handle = min(pixels.shape[1] - 6, x + 10 if number % 2 else x + pixels.shape[1] // doors - 14)
        middle = pixels.shape[0] // 2
        pixels[middle - 12 : middle + 12, handle : handle + 4] = (190, 186, 176)
    parts = box((w, d - 0.02, h), timber, (0, (d - 0.02) / 2, 0))
    parts.append(quad((w / 2, d, 0.08), (-w, 0, 0), (0, 0, h - 0.08), type(front)(pixels, front.size_m)))
    if not tall:
        for _ in range(rng.integers(1, 4)):
            paint = plain(np.array(artwork.random_rgb(rng, 0.8, (0.2, 1))) / 255)
            spot = (rng.uniform(-0.4, 0.4) * w, d / 2, h)
            parts += cylinder(
                rng.uniform(0.04, 0.09), rng.uniform(0.1, 0.35), paint, spot, top_radius=rng.uniform(0.03, 0.09)
            )
    return item("wardrobe", "cabinet", parts, (w, d, h), "wall")


def bookshelf(rng: Rng, style: Style) -> Item:
    """Return a bookshelf full of colorful spines."""
    w, d, h = rng.uniform(0.7, 1.8), rng.uniform(0.26, 0.36), rng.uniform(1.2, 2.2)
    color = pick(rng, style.woods)
    front = artwork.book_spines(rng, (w, h), max(3, round(h / 0.36)), color)
    parts = box((w, d, h), {"sides": patterns.wood(rng, color), "front": front}, (0, d / 2, 0))
    return item("bookshelf", "bookshelf", parts, (w, d, h), "wall")


def desk(rng: Rng, style: Style) -> Item:
    """Return a desk with a monitor, keyboard and papers."""
    w, d, h = rng.uniform(1.2, 1.8), rng.uniform(0.65, 0.8), 0.74
    timber = patterns.wood(rng, pick(rng, style.woods))
    parts = box((w, d, 0.04), timber, (0, d / 2, h - 0.04))
    for x in (-w / 2 + 0.02, w / 2 - 0.02):
        parts += box((0.04, d - 0.04, h - 0.04), timber, (x, d / 2, 0))
    parts += box((0.4, d - 0.1, h - 0.14), patterns.wood(rng, pick(rng, style.woods)), (w / 2 - 0.26, d / 2, 0.04))
    dark, pale = plain((0.08, 0.08, 0.09)), plain((0.93, 0.92, 0.88))
    sw = rng.uniform(0.5, 0.75)
    display = box((sw, 0.04, 0.34), {"sides": dark, "front": artwork.screen(rng, (sw, 0.34))}, (-0.1, 0.16, h + 0.12))
    display += box((0.06, 0.04, 0.14), dark, (-0.1, 0.14, h))
    display += box((0.24, 0.18, 0.012), dark, (-0.1, 0.16, h))
    clutter = box((0.44, 0.14, 0.02), dark, (-0.1, 0.44, h))
    for _ in range(rng.integers(1, 4)):
        clutter += box(
            (0.21, 0.297, rng.uniform(0.005, 0.06)), pale, (rng.uniform(-0.4, 0.4) * w, rng.uniform(0.3, 0.5), h)
        )
    return item(
        "desk", "table", parts, (w, d, h), "wall", Piece("screen", tuple(display)), Piece("box", tuple(clutter))
    )


def television(rng: Rng, style: Style) -> Item:
    """Return a low board with a television on it."""
    w, d, h = rng.uniform(1.2, 1.9), 0.42, rng.uniform(0.4, 0.55)
    tv = rng.uniform(0.9, 1.3)
    dark = plain((0.06, 0.06, 0.07))
    board = box((w, d, h), patterns.wood(rng, pick(rng, style.woods)), (0, d / 2, 0))
    tube = box(
        (tv, 0.05, tv * 0.58), {"sides": dark, "front": artwork.screen(rng, (tv, tv * 0.58))}, (0, 0.2, h + 0.06)
    )
    tube += box((0.4, 0.2, 0.06), dark, (0, 0.2, h))
    return item("television", "cabinet", board, (w, d, h), "wall", Piece("screen", tuple(tube)))


def appliance(rng: Rng, style: Style) -> Item:
    """Return a fridge or washing machine."""
    w, d = 0.6, 0.62
    h = rng.choice([0.85, 1.7, 1.95])
    paint = plain(pick(rng, ((0.92, 0.92, 0.93), (0.62, 0.63, 0.65), (0.2, 0.2, 0.22), *style.accents[:1])))
    grey = plain((0.4, 0.4, 0.42))
    parts = box((w, d - 0.03, h), paint, (0, (d - 0.03) / 2, 0))
    split = h * rng.uniform(0.4, 0.7)
    parts += box((w - 0.01, 0.02, split - 0.06), paint, (0, d - 0.02, 0.05))
    parts += box((w - 0.01, 0.02, h - split - 0.02), paint, (0, d - 0.02, split + 0.01))
    parts += box((0.025, 0.03, 0.3), grey, (-w / 2 + 0.07, d, split - 0.36))
    return item("appliance", "appliance", parts, (w, d + 0.03, h), "wall")


def carton(rng: Rng, style: Style) -> Item:
    """Return a pile of one to three moving boxes."""
    paint = patterns.fabric(rng, (0.66, 0.50, 0.33))
    parts: list[Part] = []
    w, d, base = rng.uniform(0.35, 0.7), rng.uniform(0.3, 0.55), 0.0
    tape = plain(pick(rng, style.accents))
    for _ in range(rng.integers(1, 4)):
        h = rng.uniform(0.25, 0.45)
        a, b = w * rng.uniform(0.7, 1.0), d * rng.uniform(0.7, 1.0)
        parts += box((a, b, h), paint, (0, d / 2, base))
        parts += box((a * 1.004, 0.06, h * 1.002), tape, (0, d / 2, base), skip=("front", "back", "bottom"))
        base += h * 1.003
    return item("carton", "box", parts, (w, d, base), "middle")
