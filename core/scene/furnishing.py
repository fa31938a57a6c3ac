"""Putting furniture into a room: against walls, in corners, in the middle, on walls and ceiling, without collisions."""

from collections.abc import Sequence

import numpy as np

from core.scene import decoration
from core.scene.furniture import FREE_FURNITURE, WALL_FURNITURE, chair
from core.scene.objects import Footprint, Item, SceneObject, placed
from core.scene.patterns import Rng
from core.scene.room_shell import Room
from core.scene.solids import Vector
from core.scene.style import Style

_TRIES = 40
_WALKWAY_M = 0.9


class Furnisher:
    """Places items in one room, remembering what is occupied.

    room: where. name: prefix of the keys. occupied: things that are already there.
    """

    def __init__(self, rng: Rng, style: Style, room: Room, number: int, occupied: Sequence[SceneObject] = ()) -> None:
        self.rng, self.style, self.room, self.number = rng, style, room, number
        self.objects: list[SceneObject] = []
        self._standing = [thing.footprint for thing in occupied if thing.footprint and not _is_flat(thing)]
        self._hanging = [thing.footprint for thing in occupied if thing.footprint and _hangs(thing)]
        self._doorways = [_doorway(room, wall, start, width) for wall, start, width in _doors(room)]

    def furnish(self, density: float) -> None:
        """Fill the room with what a room of its size holds."""
        rng, area = self.rng, self.room.size_m[0] * self.room.size_m[1]
        self.add_fixtures()
        for _ in range(int(np.clip(round((2.5 + area * 0.22) * density), 2, 14))):
            self.add_wall_item()
        for _ in range(int(np.clip(round((0.5 + area * 0.06) * density), 1, 5))):
            self.add_free_item()
        for _ in range(rng.integers(1, 3) + int(area / 25)):
            self.add_corner_item()
        for _ in range(rng.integers(1, 3)):
            self.add_rug()
        for _ in range(int(np.clip(round((1 + 0.18 * area) * density), 2, 12))):
            self.add_picture()

    def add_fixtures(self) -> None:
        """Hang the ceiling lamps, and put radiators below windows and curtains beside them."""
        width, depth = self.room.size_m
        columns, rows = max(1, round(width / 3.5)), max(1, round(depth / 3.5))
        power = 1.5 * width * depth / (columns * rows) / 6
        for row in range(rows):
            for column in range(columns):
                x = self.room.x0 + width * (column + 0.5) / columns + self.rng.uniform(-0.2, 0.2)
                y = self.room.y0 + depth * (row + 0.5) / rows + self.rng.uniform(-0.2, 0.2)
                lamp = decoration.ceiling_lamp(self.rng, self.style, power)
                self._put(lamp, 0.0, (x, y, self.room.height_m), None)
        for hole in self.room.openings:
            if hole.kind == "window":
                if hole.sill_m > 0.7 and self.rng.random() < 0.7:
                    heater = decoration.radiator(self.rng, hole.width_m * self.rng.uniform(0.6, 1.0))
                    self._at_wall(heater, hole.wall, hole.start_m + hole.width_m / 2)
                if self.rng.random() < 0.5:
                    for side in (hole.start_m - 0.2, hole.start_m + hole.width_m + 0.2):
                        drape = decoration.curtain(
                            self.rng, self.style, min(hole.top_m + 0.2, self.room.height_m - 0.02)
                        )
                        self._at_wall(drape, hole.wall, side)

    def add_wall_item(self) -> bool:
        """Put one large thing against a wall; tell whether there was room."""
        build = WALL_FURNITURE[self.rng.choice(list(WALL_FURNITURE))]
        thing = build(self.rng, self.style)
        for _ in range(_TRIES):
            wall = int(self.rng.integers(4))
            half, length = thing.size_m[0] / 2 + 0.03, self.room.wall_length_m(wall)
            if length > 2 * half and self._at_wall(thing, wall, self.rng.uniform(half, length - half)):
                if thing.name == "desk":
                    self._chair_in_front(self.objects[-1])
                return True
        return False

    def add_free_item(self) -> bool:
        """Put a table with its chairs, a single chair or boxes anywhere on the floor; tell whether there was room."""
        build = FREE_FURNITURE[self.rng.choice(list(FREE_FURNITURE), p=(0.5, 0.25, 0.25))]
        thing = build(self.rng, self.style)
        if not self._anywhere(thing, 0.7 if thing.name == "table" else 0.3):
            return False
        if thing.name == "table":
            self._chairs_around(self.objects[-1])
        return True

    def add_corner_item(self) -> bool:
        """Put a plant or a lamp near a wall; tell whether there was room."""
        build = (decoration.plant, decoration.floor_lamp)[self.rng.integers(2)]
        thing = build(self.rng, self.style)
        for _ in range(_TRIES):
            wall = int(self.rng.integers(4))
            length = self.room.wall_length_m(wall)
            along = self.rng.uniform(0.25, 0.8)
            if self._at_wall(thing, wall, along if self.rng.random() < 0.5 else length - along):
                return True
        return False

    def add_rug(self) -> bool:
        """Lay one rug; tell whether it fits."""
        width, depth = self.room.size_m
        return self._anywhere(decoration.rug(self.rng, self.style, (width * 0.7, depth * 0.7)), 0.1, flat=True)

    def add_picture(self) -> bool:
        """Hang one picture; tell whether there was room."""
        thing = decoration.wall_picture(self.rng, self.style)
        for _ in range(_TRIES):
            wall = int(self.rng.integers(4))
            half, length = thing.size_m[0] / 2 + 0.05, self.room.wall_length_m(wall)
            if length > 2 * half and self._at_wall(thing, wall, self.rng.uniform(half, length - half)):
                return True
        return False

    def add_again(self, thing: Item) -> bool:
        """Put a thing that stood elsewhere at a new place; tell whether there was room."""
        for _ in range(_TRIES):
            if thing.anchor in ("middle", "floor"):
                return self._anywhere(thing, 0.05, flat=thing.anchor == "floor")
            wall = int(self.rng.integers(4))
            half, length = thing.size_m[0] / 2 + 0.03, self.room.wall_length_m(wall)
            if length > 2 * half and self._at_wall(thing, wall, self.rng.uniform(half, length - half)):
                return True
        return False

    def _at_wall(self, thing: Item, wall: int, along_m: float) -> bool:
        start, along, inward = self.room.wall_frame(wall)
        at = start + along_m * along + 0.015 * inward
        half = thing.size_m[0] / 2
        ends = at - half * along, at + half * along + thing.size_m[1] * inward
        area = _footprint(ends[0][:2], ends[1][:2])
        hung = thing.anchor == "hung"
        if not self._inside(area) or self._covers_opening(thing, wall, along_m - half, along_m + half):
            return False
        # A picture may hang above low things, but not behind tall ones.
        rivals = self._hanging if hung else self._standing
        if any(area.overlaps(other, 0.06 if hung else 0.02) for other in rivals):
            return False
        if hung and any(
            area.overlaps(tall.footprint, 0.03) for tall in self.objects if tall.footprint and _is_tall(tall)
        ):
            return False
        if not hung and any(area.overlaps(way) for way in self._doorways):
            return False
        self._put(thing, float(np.arctan2(inward[1], inward[0])) - np.pi / 2, (at[0], at[1], 0.0), area)
        return True

    def _anywhere(self, thing: Item, gap: float, flat: bool = False) -> bool:
        for _ in range(_TRIES):
            yaw = int(self.rng.integers(4)) * np.pi / 2
            yaw += 0.0 if flat else self.rng.normal(0, 0.12)
            x = self.rng.uniform(self.room.x0 + 0.2, self.room.x1 - 0.2)
            y = self.rng.uniform(self.room.y0 + 0.2, self.room.y1 - 0.2)
            area = _turned_footprint(thing, yaw, x, y)
            if not self._inside(area):
                continue
            if flat or not any(area.overlaps(other, gap) for other in (*self._standing, *self._doorways)):
                lift = 0.012 * sum(_is_flat(other) for other in self.objects) if flat else 0.0
                self._put(thing, yaw, (x, y, lift), area)
                return True
        return False

    def _chairs_around(self, table: SceneObject) -> None:
        area = table.footprint
        assert area is not None
        seat = chair(self.rng, self.style)
        middle_x, middle_y = (area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2
        reach = self.rng.uniform(0.3, 0.5)
        spots = [(area.x0 - reach, middle_y, -np.pi / 2), (area.x1 + reach, middle_y, np.pi / 2)]
        spots += [(middle_x, area.y0 - reach, 0.0), (middle_x, area.y1 + reach, np.pi)]
        for x, y, yaw in spots:
            if self.rng.random() < 0.75:
                self._try_at(seat, yaw + self.rng.normal(0, 0.15), x, y)

    def _chair_in_front(self, desk: SceneObject) -> None:
        area = desk.footprint
        assert area is not None
        middle = np.array([(area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2])
        center = np.array([(self.room.x0 + self.room.x1) / 2, (self.room.y0 + self.room.y1) / 2])
        wide = area.x1 - area.x0 > area.y1 - area.y0
        away = np.array([0, 1.0]) if wide else np.array([1.0, 0])
        away = away * np.sign((center - middle) @ away or 1.0)
        reach = min(area.x1 - area.x0, area.y1 - area.y0) / 2 + 0.55
        x, y = middle + away * reach
        self._try_at(chair(self.rng, self.style), float(np.arctan2(-away[1], -away[0])) - np.pi / 2, x, y)

    def _try_at(self, thing: Item, yaw: float, x: float, y: float) -> bool:
        area = _turned_footprint(thing, yaw, x, y)
        if not self._inside(area) or any(area.overlaps(other, 0.01) for other in self._standing):
            return False
        self._put(thing, yaw, (x, y, 0.0), area)
        return True

    def _put(self, thing: Item, yaw: float, at: tuple[float, float, float], area: Footprint | None) -> None:
        key = f"room{self.number}/{thing.name}@{at[0]:.3f},{at[1]:.3f},{yaw:.3f}"
        thing_there = placed(thing, key, yaw, at, area, self.number)
        self.objects.append(thing_there)
        if area is not None and thing.anchor != "floor":
            (self._hanging if thing.anchor == "hung" else self._standing).append(area)

    def _inside(self, area: Footprint) -> bool:
        room = self.room
        return area.x0 > room.x0 and area.y0 > room.y0 and area.x1 < room.x1 and area.y1 < room.y1

    def _covers_opening(self, thing: Item, wall: int, start: float, end: float) -> bool:
        low = 1.0 if thing.anchor == "hung" else 0.0
        return any(
            hole.wall == wall
            and start < hole.start_m + hole.width_m + 0.02
            and end > hole.start_m - 0.02
            and thing.size_m[2] + low > hole.sill_m
            for hole in self.room.openings
        )


def _doors(room: Room) -> list[tuple[int, float, float]]:
    return [(hole.wall, hole.start_m, hole.width_m) for hole in room.openings if hole.kind != "window"]


def _doorway(room: Room, wall: int, start_m: float, width_m: float) -> Footprint:
    start, along, inward = room.wall_frame(wall)
    near = start + start_m * along
    return _footprint(near[:2], (near + width_m * along + _WALKWAY_M * inward)[:2])


def _footprint(first: Vector, second: Vector) -> Footprint:
    (x0, x1), (y0, y1) = sorted((first[0], second[0])), sorted((first[1], second[1]))
    return Footprint(float(x0), float(y0), float(x1), float(y1))


def _turned_footprint(thing: Item, yaw: float, x: float, y: float) -> Footprint:
    w, d, _ = thing.size_m
    corners = np.array([(-w / 2, 0), (w / 2, 0), (-w / 2, d), (w / 2, d)])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    spread = corners @ turn + (x, y)
    return _footprint(spread.min(0).tolist(), spread.max(0).tolist())


def _is_flat(thing: SceneObject) -> bool:
    return thing.item is not None and thing.item.anchor in ("floor", "hung")


def _hangs(thing: SceneObject) -> bool:
    return thing.item is not None and thing.item.anchor == "hung"


def _is_tall(thing: SceneObject) -> bool:
    return thing.item is not None and thing.item.anchor != "hung" and thing.item.size_m[2] > 1.0
