"""Single rooms: furnished or bare, 8 to 60 m²."""

from dataclasses import replace

import numpy as np

from panoloc.lab.rooms.materials import patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style, pick
from panoloc.lab.rooms.objects.furnishing import Furnisher
from panoloc.lab.rooms.objects.objects import Item, Piece, SceneObject
from panoloc.lab.rooms.objects.placement import Placer
from panoloc.lab.rooms.objects.room_shell import Opening, Room, build_shell
from panoloc.lab.rooms.objects.solids import box
from panoloc.lab.rooms.scenes.scene import Scene


def furnished_room(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return one furnished room."""
    room = random_room(rng, area_m2)
    return Scene(tuple(furnished(rng, style, room, 0)), (room,), style)


def furnished(rng: Rng, style: Style, room: Room, number: int) -> list[SceneObject]:
    """Return walls and furniture of the room with the given number in its scene."""
    shell = [*build_shell(rng, style, room, f"room{number}"), *projections(rng, style, room)]
    furnisher = Furnisher(rng, style, room, number, shell)
    furnisher.furnish(style.density * rng.uniform(0.8, 1.2))
    return [*shell, *furnisher.objects]


def bare_room(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return a nearly empty room: plain walls, door, windows, radiators, sockets, perhaps a thing or two left behind."""
    room = random_room(rng, area_m2 or float(rng.uniform(9, 26)))
    shell = [*build_shell(rng, style, room, "room0", bare=True), *projections(rng, style, room)]
    furnisher = Furnisher(rng, style, room, 0, shell)
    furnisher.add_fixtures()
    furnisher.add_small_fittings()
    if rng.random() < 0.4:
        furnisher.add_free_item()
    return Scene((*shell, *furnisher.objects), (room,), style)


def projections(rng: Rng, style: Style, room: Room) -> list[SceneObject]:
    """Return what breaks the symmetry of a rectangle: perhaps a chimney breast at a wall or a boxed-in pipe."""
    if rng.random() < 0.5:
        return []
    width, depth = (rng.uniform(0.9, 1.5), rng.uniform(0.25, 0.45)) if rng.random() < 0.5 else (0.35, 0.35)
    block = plain_block(rng, style, (width, depth, room.height_m))
    placer = Placer(rng, room, 0)
    if not placer.along_wall(block):
        return []
    return [replace(thing, key=f"fixed/{thing.key}", movable=False, item=None) for thing in placer.objects]


def plain_block(rng: Rng, style: Style, size_m: tuple[float, float, float]) -> Item:
    """Return a plastered block of the given size."""
    paint = patterns.plaster(rng, pick(rng, style.walls), (2.0, 2.0), 0.6)
    parts = box(size_m, paint, (0, size_m[1] / 2 - 0.01, 0), skip=("top", "bottom"))
    return Item("block", (Piece("wall", tuple(parts)),), size_m, "wall")


def random_room(rng: Rng, area_m2: float | None) -> Room:
    """Draw the size of a room and its door and windows."""
    area = area_m2 or float(np.exp(rng.uniform(np.log(9), np.log(55))))
    ratio = rng.uniform(1.0, 1.7)
    width, depth = np.sqrt(area * ratio), np.sqrt(area / ratio)
    if rng.random() < 0.5:
        width, depth = depth, width
    plan = Room(-width / 2, -depth / 2, width / 2, depth / 2, rng.uniform(2.4, 3.0))
    walls = list(rng.permutation(4))
    openings = [random_door(rng, plan, int(walls[0]))]
    for wall in walls[1 : 1 + int(rng.integers(1, 3))]:
        openings += random_windows(rng, plan, int(wall))
    return Room(plan.x0, plan.y0, plan.x1, plan.y1, plan.height_m, tuple(openings))


def random_door(rng: Rng, room: Room, wall: int) -> Opening:
    """Draw a door in a wall."""
    width = rng.uniform(0.8, 0.95)
    start = rng.uniform(0.15, max(0.16, room.wall_length_m(wall) - width - 0.15))
    return Opening(wall, start, width, 0.0, rng.uniform(2.0, 2.1), "door")


def random_windows(rng: Rng, room: Room, wall: int) -> list[Opening]:
    """Draw one or two windows in a wall."""
    length = room.wall_length_m(wall)
    count = 1 if length < 3.5 else int(rng.integers(1, 3))
    sill, top = rng.choice([0.02, 0.85, 0.95, 1.1]), min(room.height_m - 0.25, rng.uniform(2.1, 2.35))
    windows = []
    for number in range(count):
        slot = length / count
        width = min(rng.uniform(0.9, 2.2), slot - 0.7)
        if width > 0.5:
            start = number * slot + rng.uniform(0.3, max(0.31, slot - width - 0.3))
            windows.append(Opening(wall, start, width, sill, top, "window", 0.16))
    return windows
