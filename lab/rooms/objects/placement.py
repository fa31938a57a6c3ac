"""Finding free places for items in one room: along walls, on walls, on the floor."""

from collections.abc import Sequence

import numpy as np

from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.objects.objects import Footprint, Item, SceneObject, placed
from panoloc.lab.rooms.objects.room_shell import Room
from panoloc.lab.rooms.objects.solids import Vector

_TRIES = 40
_WALKWAY_M = 0.9
_TALL_M = 1.0


class Placer:
    """Puts items into one room and remembers what is occupied.

    number: of the room in its scene. there: objects that already stand in the room. objects: what was put so far.
    """

    def __init__(self, rng: Rng, room: Room, number: int, there: Sequence[SceneObject] = ()) -> None:
        self.rng, self.room, self.number = rng, room, number
        self.objects: list[SceneObject] = []
        self._there = list(there)
        self._doorways = [_doorway(room, *door) for door in _doors(room)]

    def along_wall(self, thing: Item, margin_m: float = 0.03) -> bool:
        """Put a thing with its back to a wall, or hang it there; return whether there was room."""
        half = thing.size_m[0] / 2 + margin_m
        for _ in range(_TRIES):
            wall = int(self.rng.integers(4))
            length = self.room.wall_length_m(wall)
            if length > 2 * half and self.at_wall(thing, wall, self.rng.uniform(half, length - half)):
                return True
        return False

    def near_corner(self, thing: Item) -> None:
        """Put a thing at a wall within 0.8 m of a corner, if there is room."""
        for _ in range(_TRIES):
            wall = int(self.rng.integers(4))
            length, along = self.room.wall_length_m(wall), self.rng.uniform(0.25, 0.8)
            if self.at_wall(thing, wall, along if self.rng.random() < 0.5 else length - along):
                return

    def on_floor(self, thing: Item, gap_m: float) -> bool:
        """Put a thing anywhere with `gap_m` of free floor around it (flat things may lie under others)."""
        flat = thing.anchor == "floor"
        for _ in range(_TRIES):
            yaw = int(self.rng.integers(4)) * np.pi / 2 + (0.0 if flat else self.rng.normal(0, 0.12))
            x = self.rng.uniform(self.room.x0 + 0.2, self.room.x1 - 0.2)
            y = self.rng.uniform(self.room.y0 + 0.2, self.room.y1 - 0.2)
            area = turned_footprint(thing, yaw, x, y)
            if not self._inside(area):
                continue
            if flat or not any(area.overlaps(other, gap_m) for other in (*self._standing(), *self._doorways)):
                # Rugs lie on top of each other, so that no two surfaces coincide.
                lift = 0.012 * sum(_anchor(other) == "floor" for other in self._all()) if flat else 0.0
                self.put(thing, yaw, (x, y, lift), area)
                return True
        return False

    def at_wall(self, thing: Item, wall: int, along_m: float) -> bool:
        """Put or hang a thing centred `along_m` along a wall; return whether the place was free."""
        start, along, inward = self.room.wall_frame(wall)
        at = start + along_m * along + 0.015 * inward
        half = thing.size_m[0] / 2
        area = _footprint(at - half * along, at + half * along + thing.size_m[1] * inward)
        if not self._inside(area) or self._covers_opening(thing, wall, along_m - half, along_m + half):
            return False
        if thing.anchor == "hung":
            rivals = [other.footprint for other in self._all() if other.footprint and not _is_low(other)]
            taken = any(area.overlaps(other, 0.05) for other in rivals)
        elif thing.size_m[2] > _TALL_M:
            taken = any(area.overlaps(other, 0.02) for other in map(_solid_area, self._all()) if other)
        else:
            taken = any(area.overlaps(other, 0.02) for other in self._standing())
        if taken or (thing.anchor != "hung" and any(area.overlaps(way) for way in self._doorways)):
            return False
        self.put(thing, float(np.arctan2(inward[1], inward[0])) - np.pi / 2, (at[0], at[1], 0.0), area)
        return True

    def at(self, thing: Item, yaw: float, x: float, y: float) -> None:
        """Put a thing exactly there, if the place is free."""
        area = turned_footprint(thing, yaw, x, y)
        if self._inside(area) and not any(area.overlaps(other, 0.01) for other in self._standing()):
            self.put(thing, yaw, (x, y, 0.0), area)

    def put(self, thing: Item, yaw: float, at: tuple[float, float, float], area: Footprint | None) -> None:
        """Put a thing there without asking."""
        key = f"room{self.number}/{thing.name}@{at[0]:.3f},{at[1]:.3f},{yaw:.3f}"
        self.objects.append(placed(thing, key, yaw, at, area, self.number))

    def _all(self) -> list[SceneObject]:
        return [*self._there, *self.objects]

    def _standing(self) -> list[Footprint]:
        return [o.footprint for o in self._all() if o.footprint and _anchor(o) not in ("floor", "hung")]

    def _inside(self, area: Footprint) -> bool:
        room = self.room
        return area.x0 > room.x0 and area.y0 > room.y0 and area.x1 < room.x1 and area.y1 < room.y1

    def _covers_opening(self, thing: Item, wall: int, start: float, end: float) -> bool:
        top = 2.0 if thing.anchor == "hung" else thing.size_m[2]
        return any(
            hole.wall == wall
            and start < hole.start_m + hole.width_m + 0.02
            and end > hole.start_m - 0.02
            and top > hole.sill_m
            for hole in self.room.openings
        )


def turned_footprint(thing: Item, yaw: float, x: float, y: float) -> Footprint:
    """Return the floor area of a thing with its origin at (x, y), turned by `yaw` radians."""
    w, d, _ = thing.size_m
    corners = np.array([(-w / 2, 0), (w / 2, 0), (-w / 2, d), (w / 2, d)])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    spread = corners @ turn + (x, y)
    return _footprint(spread.min(0), spread.max(0))


def _footprint(first: Vector, second: Vector) -> Footprint:
    (x0, x1), (y0, y1) = sorted((first[0], second[0])), sorted((first[1], second[1]))
    return Footprint(float(x0), float(y0), float(x1), float(y1))


def _doors(room: Room) -> list[tuple[int, float, float]]:
    return [(hole.wall, hole.start_m, hole.width_m) for hole in room.openings if hole.kind != "window"]


def _doorway(room: Room, wall: int, start_m: float, width_m: float) -> Footprint:
    start, along, inward = room.wall_frame(wall)
    near = start + start_m * along
    return _footprint(near, near + width_m * along + _WALKWAY_M * inward)


def _anchor(thing: SceneObject) -> str:
    return thing.item.anchor if thing.item else "fixed"


def _solid_area(thing: SceneObject) -> Footprint | None:
    return None if _anchor(thing) == "floor" else thing.footprint


def _is_low(thing: SceneObject) -> bool:
    return thing.item is not None and thing.item.anchor != "hung" and thing.item.size_m[2] <= _TALL_M
