"""Flats of 4 to 6 furnished rooms, connected by open doorways."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style
from panoloc.lab.rooms.objects.furnishing import Furnisher
from panoloc.lab.rooms.objects.objects import Piece, SceneObject
from panoloc.lab.rooms.objects.room_shell import Opening, Room, build_shell, door_panel
from panoloc.lab.rooms.objects.solids import box, moved
from panoloc.lab.rooms.scenes.room_scene import random_door, random_windows
from panoloc.lab.rooms.scenes.scene import Scene

_WALL_M = 0.14
_SHARED_M = 1.15


@dataclass(frozen=True)
class Cell:
    """A rectangle of the plan, up to the middle of its walls."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def area(self) -> float:
        """Return the area in m²."""
        return (self.x1 - self.x0) * (self.y1 - self.y0)


def furnished_flat(rng: Rng, style: Style) -> Scene:
    """Return a flat of 4 to 6 rooms."""
    cells = _divide(rng, int(rng.integers(4, 7)))
    height = rng.uniform(2.4, 2.8)
    half = _WALL_M / 2
    rooms = [Room(c.x0 + half, c.y0 + half, c.x1 - half, c.y1 - half, height) for c in cells]
    leaves: list[SceneObject] = []
    for first, second in _connections(rng, cells):
        _connect(rng, style, cells, rooms, first, second, leaves)
    _open_outwards(rng, cells, rooms)
    roles = _roles(cells)
    objects: list[SceneObject] = list(leaves)
    for number, room in enumerate(rooms):
        shell = build_shell(rng, style, room, f"room{number}")
        furnisher = Furnisher(rng, style, room, number, shell, roles[number])
        furnisher.furnish(style.density * rng.uniform(0.7, 1.1))
        objects += [*shell, *furnisher.objects]
    return Scene(tuple(objects), tuple(rooms), style)


def _divide(rng: Rng, num_rooms: int) -> list[Cell]:
    """Split a rectangle into rooms, always the largest one, across its longer side."""
    area = rng.uniform(11, 16) * num_rooms
    ratio = rng.uniform(1.1, 1.6)
    width, depth = np.sqrt(area * ratio), np.sqrt(area / ratio)
    cells = [Cell(-width / 2, -depth / 2, width / 2, depth / 2)]
    while len(cells) < num_rooms:
        largest = max(cells, key=lambda cell: cell.area)
        cells.remove(largest)
        share = rng.uniform(0.38, 0.62)
        if largest.x1 - largest.x0 > largest.y1 - largest.y0:
            cut = largest.x0 + share * (largest.x1 - largest.x0)
            cells += [replace(largest, x1=cut), replace(largest, x0=cut)]
        else:
            cut = largest.y0 + share * (largest.y1 - largest.y0)
            cells += [replace(largest, y1=cut), replace(largest, y0=cut)]
    return cells


def _shared(a: Cell, b: Cell) -> tuple[int, float, float, float] | None:
    """Return axis of the common wall (0: wall at constant x), its coordinate, and its extent; None if the cells do not touch."""
    for axis, low_a, high_a, low_b, high_b, start, end in (
        (0, a.x0, a.x1, b.x0, b.x1, max(a.y0, b.y0), min(a.y1, b.y1)),
        (1, a.y0, a.y1, b.y0, b.y1, max(a.x0, b.x0), min(a.x1, b.x1)),
    ):
        for edge, other in ((high_a, low_b), (low_a, high_b)):
            if abs(edge - other) < 1e-9 and end - start > _SHARED_M + _WALL_M:
                return axis, edge, start, end
    return None


def _connections(rng: Rng, cells: list[Cell]) -> list[tuple[int, int]]:
    """Draw a tree of doorways that reaches every room, and now and then one more."""
    pairs = [(a, b) for a, b in combinations(range(len(cells)), 2) if _shared(cells[a], cells[b])]
    group = list(range(len(cells)))
    chosen = []
    for index in rng.permutation(len(pairs)):
        a, b = pairs[index]
        if group[a] != group[b] or rng.random() < 0.2:
            chosen.append((a, b))
            merged, old = group[a], group[b]
            group = [merged if g == old else g for g in group]
    return chosen


def _connect(
    rng: Rng, style: Style, cells: list[Cell], rooms: list[Room], first: int, second: int, leaves: list[SceneObject]
) -> None:
    """Cut a doorway into the wall between two rooms and hang an open door in most."""
    common = _shared(cells[first], cells[second])
    assert common is not None
    axis, at, start, end = common
    width, top = rng.uniform(0.8, 0.95), rng.uniform(2.0, 2.08)
    place = rng.uniform(start + _WALL_M, end - _WALL_M - width)
    ends = np.array([[at, place, 0], [at, place + width, 0]])
    ends = ends if axis == 0 else ends[:, [1, 0, 2]]
    for number, depth in ((first, _WALL_M), (second, 0.0)):
        room = rooms[number]
        middle = (room.x0 + room.x1) / 2 if axis == 0 else (room.y0 + room.y1) / 2
        wall = (1 if middle < at else 3) if axis == 0 else (2 if middle < at else 0)
        origin, along, _ = room.wall_frame(wall)
        hole = Opening(wall, float(min((ends - origin) @ along)), width, 0.0, top, "passage", depth)
        rooms[number] = replace(room, openings=(*room.openings, hole))
        if depth > 0 and rng.random() < 0.7:
            leaves.append(_open_leaf(rng, style, rooms[number], hole, f"leaf{first}-{second}"))


def _open_leaf(rng: Rng, style: Style, room: Room, hole: Opening, key: str) -> SceneObject:
    """Return a door leaf that stands open into the room."""
    origin, along, inward = room.wall_frame(hole.wall)
    size = (hole.width_m - 0.02, hole.top_m - 0.01)
    panel = door_panel(rng, style, size)
    # Built along +x from its hinge, then turned: 0 would close the doorway, a quarter turn stands straight into the room.
    leaf = moved(box((size[0], 0.04, size[1]), panel), 0.0, (size[0] / 2, 0.0, 0.005))
    yaw = float(np.arctan2(along[1], along[0]) - rng.uniform(np.radians(75), np.radians(100)))
    hinge = origin + (hole.start_m + 0.01) * along + 0.03 * inward
    # Turning from `along` by −90° about z must point inwards: along x up = inward.
    swinging = (Piece("door", tuple(moved(leaf, yaw, hinge))),)
    return SceneObject(key, swinging, hinge=(float(hinge[0]), float(hinge[1])))


def _open_outwards(rng: Rng, cells: list[Cell], rooms: list[Room]) -> None:
    """Cut windows into outer walls, and one entrance door."""
    bounds = min(c.y0 for c in cells), max(c.x1 for c in cells), max(c.y1 for c in cells), min(c.x0 for c in cells)
    entrance = int(rng.integers(len(cells)))
    for number in np.roll(np.arange(len(cells)), -entrance):
        cell, room = cells[number], rooms[number]
        edges = cell.y0, cell.x1, cell.y1, cell.x0
        outer = [wall for wall in range(4) if abs(edges[wall] - bounds[wall]) < 1e-9]
        rng.shuffle(outer)
        openings = list(room.openings)
        if number == entrance and outer:
            openings.append(random_door(rng, room, outer.pop()))
        for wall in outer[:2]:
            openings += random_windows(rng, room, wall)
        rooms[number] = replace(room, openings=tuple(openings))


def _roles(cells: list[Cell]) -> list[str]:
    """Give the largest cell the living room and the smallest the bathroom."""
    order = [*("living", "bedroom", "kitchen", "study", "bedroom")[: len(cells) - 1], "bathroom"]
    by_size = sorted(range(len(cells)), key=lambda number: -cells[number].area)
    return [order[by_size.index(number)] for number in range(len(cells))]
