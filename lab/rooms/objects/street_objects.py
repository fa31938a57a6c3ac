"""Things on a street: parked cars, trees, lamp posts, benches, bins, signs and people."""

import numpy as np

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.texture import Texture, plain
from panoloc.lab.rooms.objects.furniture import item
from panoloc.lab.rooms.objects.objects import Item, Piece
from panoloc.lab.rooms.objects.solids import Part, box, cylinder, ellipsoid, moved, quad


def car(rng: Rng) -> Item:
    """Return a car: body, tapered cabin with windows, wheels and lights. Its length runs along x."""
    length, width, height = rng.uniform(3.7, 4.8), rng.uniform(1.65, 1.85), rng.uniform(1.4, 1.9)
    lot = rng.random()
    tone = rng.uniform(0.08, 0.9)
    color = np.full(3, tone) if lot < 0.5 else np.array(artwork.random_rgb(rng, 0.95, (0.3, 0.85))) / 255
    paint, glass, black = plain(color), plain((0.13, 0.16, 0.19)), plain((0.06, 0.06, 0.06))
    y, waist = width / 2, height * 0.56
    parts = box((length, width, waist - 0.28), paint, (0, y, 0.28))
    front, back = length * rng.uniform(0.12, 0.22), -length * rng.uniform(0.4, 0.47)
    parts += _cabin(front, back, width, waist, height, paint, glass)
    for x in (-length * 0.31, length * 0.31):
        for side in (0.02, width - 0.2):
            parts += _wheel(x, side, 0.31, 0.18, black)
    red, white = plain((0.7, 0.08, 0.06)), plain((0.92, 0.92, 0.86))
    for side in (0.22, width - 0.22):
        parts += box((0.03, 0.26, 0.14), red, (-length / 2, side, waist - 0.24))
        parts += box((0.03, 0.26, 0.14), white, (length / 2, side, waist - 0.24))
    parts += box((0.02, 0.5, 0.11), white, (-length / 2 - 0.005, y, 0.42))
    return item("car", "car", parts, (length, width, height), "road")


def tree(rng: Rng) -> Item:
    """Return a street tree with a crown of leafy blobs."""
    trunk, crown = rng.uniform(1.9, 2.8), rng.uniform(1.1, 1.9)
    bark = patterns.concrete(rng, (0.34, 0.27, 0.20), (1.0, 1.0))
    season = np.array(((0.24, 0.40, 0.14), (0.30, 0.44, 0.18), (0.50, 0.40, 0.14)))[rng.integers(3)]
    parts = cylinder(0.14, trunk + 0.6, bark, (0, 0, 0), top_radius=0.09, num_sides=9)
    for _ in range(rng.integers(7, 12)):
        size = crown * rng.uniform(0.35, 0.6)
        spot = (rng.normal(0, crown * 0.4), rng.normal(0, crown * 0.4), trunk + crown * rng.uniform(0.2, 1.3))
        leaves = artwork.foliage(rng, season * rng.uniform(0.8, 1.2), (1.0, 1.0))
        parts += ellipsoid((size, size, size * 0.8), leaves, spot)
    return item("tree", "tree", parts, (0.6, 0.6, trunk + 2 * crown), "pavement")


def lamp_post(rng: Rng) -> Item:
    """Return a street lamp with its arm towards +y."""
    height, grey = rng.uniform(4.0, 5.5), plain(np.full(3, rng.uniform(0.2, 0.5)))
    parts = cylinder(0.08, height, grey, (0, 0, 0), top_radius=0.05, num_sides=8)
    parts += box((0.06, 1.2, 0.06), grey, (0, 0.6, height - 0.05))
    parts += box((0.2, 0.5, 0.1), plain((0.9, 0.9, 0.85)), (0, 1.2, height - 0.14))
    return item("lamp_post", "pole", parts, (0.3, 0.3, height), "pavement")


def sign(rng: Rng) -> Item:
    """Return a traffic sign."""
    height, size = rng.uniform(2.2, 2.6), 0.6
    colors = ((190, 30, 30), (30, 70, 160), (235, 235, 230), (230, 180, 40))
    pixels = np.full((48, 48, 3), colors[rng.integers(4)], np.uint8)
    pixels[8:40, 8:40] = colors[rng.integers(4)]
    pixels[18:30, 10:38] = colors[rng.integers(4)]
    face = Texture(pixels, (size, size))
    parts = cylinder(0.035, height + size, plain((0.55, 0.56, 0.57)), (0, 0, 0), num_sides=7)
    parts += box((size, 0.02, size), {"sides": plain((0.6, 0.6, 0.6)), "front": face}, (0, 0.05, height))
    return item("sign", "pole", parts, (0.6, 0.2, height + size), "pavement")


def bench(rng: Rng) -> Item:
    """Return a bench or a row of bins."""
    if rng.random() < 0.5:
        timber = patterns.wood(rng, (0.46, 0.33, 0.22))
        parts = box((1.6, 0.45, 0.05), timber, (0, 0.3, 0.42)) + box((1.6, 0.05, 0.4), timber, (0, 0.06, 0.5))
        for x in (-0.65, 0.65):
            parts += box((0.08, 0.45, 0.42), plain((0.2, 0.2, 0.2)), (x, 0.3, 0))
        return item("bench", "chair", parts, (1.6, 0.6, 0.9), "pavement")
    bins: list[Part] = []
    for x in (-0.65, 0.0, 0.65):
        color = np.array(artwork.random_rgb(rng, 0.8, (0.15, 0.6))) / 255
        bins += box((0.56, 0.6, 0.95), plain(color), (x, 0.35, 0)) + box(
            (0.6, 0.66, 0.08), plain(color * 0.7), (x, 0.35, 0.95)
        )
    return item("bins", "box", bins, (1.9, 0.7, 1.05), "pavement")


def facade(rng: Rng, width: float, height: float) -> tuple[Piece, ...]:
    """Return the front of a house, 6 m deep behind y = 0: wall, plinth, windows with sills, door, cornice, perhaps balconies."""
    wall = _facade_material(rng)
    body = box((width, 6.0, height), wall, (0, -3.0, 0), skip=("bottom", "back"), step_m=0.7)
    stone = plain(np.full(3, rng.uniform(0.4, 0.8)))
    body += box((width, 0.06, rng.uniform(0.4, 0.9)), stone, (0, 0.03, 0), skip=("back",), step_m=1.0)
    body += box((width + 0.05, 0.3, 0.25), stone, (0, 0.1, height - 0.25), step_m=0.8)
    windows, doors = [], []
    floors, columns = max(2, int(height / 3.0)), max(2, int(width / rng.uniform(1.9, 2.6)))
    pitch, w, h = width / columns, rng.uniform(0.9, 1.3), rng.uniform(1.3, 1.8)
    door_column, balconies = int(rng.integers(columns)), rng.random() < 0.3
    frame = np.array(artwork.random_rgb(rng, 0.4, (0.3, 0.98))) / 255
    for floor in range(floors):
        for column in range(columns):
            x, z = (column + 0.5) * pitch - width / 2, 1.1 + floor * (height - 0.6) / floors
            if floor == 0 and column == door_column:
                doors += _front_door(rng, x)
                continue
            windows.append(quad((x + w / 2, 0.02, z), (-w, 0, 0), (0, 0, h), _window(rng, frame, (w, h)), step_m=1.0))
            body += box((w + 0.2, 0.16, 0.07), stone, (x, 0.08, z - 0.07), skip=("back",), step_m=1.0)
            if balconies and floor > 0 and column % 2 == 0:
                rail = plain((0.2, 0.2, 0.22))
                body += box((1.7, 0.8, 0.12), stone, (x, 0.4, z - 0.3), step_m=1.0) + box(
                    (1.7, 0.04, 0.7), rail, (x, 0.78, z - 0.18)
                )
    return Piece("building", tuple(body)), Piece("window", tuple(windows)), Piece("door", tuple(doors))


def _facade_material(rng: Rng) -> Texture:
    kind = rng.integers(3)
    color = np.array(artwork.random_rgb(rng, 0.35, (0.55, 0.95), hue=0.08 + 0.5 * (rng.random() < 0.2))) / 255
    if kind == 0:
        return patterns.bricks(rng, np.array([0.55, 0.30, 0.22]) * rng.uniform(0.8, 1.3))
    if kind == 1:
        return patterns.tiles(rng, color, color * 0.9, (3.2, 3.2), 0.8)
    return patterns.concrete(rng, color, (4.0, 4.0))


def _window(rng: Rng, frame: np.ndarray, size_m: tuple[float, float]) -> Texture:
    height, width = round(size_m[1] * 50), round(size_m[0] * 50)
    glass = np.array([0.16, 0.20, 0.25]) * rng.uniform(0.7, 1.8)
    rows = np.linspace(1.4, 0.8, height)[:, None, None]
    pixels = np.broadcast_to(glass * rows, (height, width, 3)).copy()
    if rng.random() < 0.5:
        drape = np.array(artwork.random_rgb(rng, 0.3, (0.5, 0.9))) / 255
        pixels[:, : width // 4], pixels[:, -width // 4 :] = drape, drape
    if rng.random() < 0.25:
        pixels[: int(height * rng.uniform(0.2, 0.7))] = 0.75
    edge = 4
    pixels[:edge], pixels[-edge:], pixels[:, :edge], pixels[:, -edge:] = frame, frame, frame, frame
    pixels[:, width // 2 - 2 : width // 2 + 2] = frame
    pixels[height // 3 - 2 : height // 3 + 1] = frame
    return patterns.finished(pixels, size_m)


def _front_door(rng: Rng, x: float) -> list[Part]:
    color = np.array(artwork.random_rgb(rng, 0.8, (0.15, 0.6))) / 255
    leaf = patterns.wood(rng, color, (1.1, 2.2))
    return [
        quad((x + 0.55, 0.07, 0.05), (-1.1, 0, 0), (0, 0, 2.2), leaf, step_m=1.0),
        *box((1.4, 0.3, 0.15), plain((0.6, 0.6, 0.58)), (x, 0.15, 0)),
    ]


def _cabin(
    front: float, back: float, width: float, low: float, high: float, paint: Texture, glass: Texture
) -> list[Part]:
    slope, inset = 0.45, 0.12
    y0, y1 = 0.04, width - 0.04
    base = np.array([(front + slope, y0, low), (front + slope, y1, low), (back, y1, low), (back, y0, low)])
    top = np.array(
        [
            (front, y0 + inset, high),
            (front, y1 - inset, high),
            (back + 0.3, y1 - inset, high),
            (back + 0.3, y0 + inset, high),
        ]
    )
    parts = []
    for k in range(4):
        after = (k + 1) % 4
        corners = np.array([base[k], base[after], top[after], top[k]])
        uv = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.6), (0.0, 0.6)])
        parts.append(Part(corners, np.array([(0, 1, 2), (0, 2, 3)]), uv, glass))
    parts.append(Part(top, np.array([(0, 1, 2), (0, 2, 3)]), top[:, :2], paint))
    return parts


def _wheel(x: float, y: float, radius: float, width: float, texture: Texture) -> list[Part]:
    """Return a cylinder lying along y."""
    upright = cylinder(radius, width, texture, num_sides=12)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    lying = [Part(part.vertices @ turn.T, part.triangles, part.uv_m, part.texture) for part in upright]
    return moved(lying, 0.0, (x, y, radius))
