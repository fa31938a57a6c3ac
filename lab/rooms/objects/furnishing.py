"""What stands in a room of a given use, and how much of it."""

from collections.abc import Callable, Sequence

import numpy as np

from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style
from panoloc.lab.rooms.objects import decoration, fittings, furniture
from panoloc.lab.rooms.objects.objects import Item, SceneObject
from panoloc.lab.rooms.objects.placement import Placer
from panoloc.lab.rooms.objects.room_shell import Room

Builder = Callable[[Rng, Style], Item]
_WALL: dict[str, tuple[Builder, ...]] = {
    "living": (furniture.sofa, furniture.sofa, furniture.television, furniture.bookshelf, furniture.wardrobe),
    "bedroom": (furniture.bed, furniture.wardrobe, furniture.wardrobe, furniture.desk, furniture.bookshelf),
    "study": (furniture.desk, furniture.desk, furniture.bookshelf, furniture.bookshelf, furniture.wardrobe),
    "kitchen": (fittings.kitchen, furniture.appliance, furniture.appliance, furniture.wardrobe),
    "bathroom": (fittings.bathtub, fittings.washbasin, fittings.toilet, furniture.wardrobe),
    "hall": (furniture.wardrobe, furniture.bookshelf),
}
_FREE: tuple[Builder, ...] = (furniture.table, furniture.table, furniture.chair, furniture.carton)
ROLES: tuple[str, ...] = tuple(_WALL)
_LARGE_M2 = 16.0


class Furnisher:
    """Furnishes one room. role: one of `ROLES`, None to mix them as large rooms do. there: what already stands."""

    def __init__(
        self,
        rng: Rng,
        style: Style,
        room: Room,
        number: int,
        there: Sequence[SceneObject] = (),
        role: str | None = None,
    ) -> None:
        self._rng, self._style, self._room = rng, style, room
        self._place = Placer(rng, room, number, there)
        drawn = rng.permutation([name for name in ROLES if name not in ("hall", "bathroom")])[:2]
        self._builders = _WALL[role] if role else tuple(build for name in drawn for build in _WALL[str(name)])

    @property
    def objects(self) -> list[SceneObject]:
        """Return what was put into the room so far."""
        return self._place.objects

    def furnish(self, density: float) -> None:
        """Fill the room with about as much as a room of its size holds."""
        rng, area = self._rng, self._room.size_m[0] * self._room.size_m[1]
        self.add_fixtures()
        for build in dict.fromkeys(self._builders):
            if rng.random() < 0.85:
                self._place.along_wall(build(rng, self._style))
        for _ in range(int(np.clip(round((0.13 * area - 1) * density), 0, 8))):
            self.add_wall_item()
        for _ in range(int(np.clip(round((0.4 + area * 0.06) * density), 0, 5))):
            self.add_free_item()
        for _ in range(rng.integers(0, 3) + int(area / 25)):
            self.add_corner_item()
        for _ in range(rng.integers(0, 2) + int(area > _LARGE_M2)):
            self.add_rug()
        for _ in range(int(np.clip(round((1 + 0.15 * area) * density * rng.uniform(0.5, 1.2)), 1, 10))):
            self.add_picture()
        self.add_small_fittings()

    def add_fixtures(self) -> None:
        """Hang the ceiling lamps, and put radiators below windows and curtains beside them."""
        width, depth = self._room.size_m
        columns, rows = max(1, round(width / 3.5)), max(1, round(depth / 3.5))
        power = 1.5 * width * depth / (columns * rows) / 6
        for row in range(rows):
            for column in range(columns):
                x = self._room.x0 + width * (column + 0.5) / columns + self._rng.uniform(-0.2, 0.2)
                y = self._room.y0 + depth * (row + 0.5) / rows + self._rng.uniform(-0.2, 0.2)
                lamp = decoration.ceiling_lamp(self._rng, self._style, power)
                self._place.put(lamp, 0.0, (x, y, self._room.height_m), None)
        for hole in self._room.openings:
            if hole.kind == "window":
                self._dress_window(hole.wall, hole.start_m, hole.width_m, hole.sill_m, hole.top_m)

    def add_small_fittings(self) -> None:
        """Put switches beside doors and sockets and ducts on walls."""
        for hole in self._room.openings:
            if hole.kind != "window":
                side = hole.start_m + (hole.width_m + 0.22 if self._rng.random() < 0.5 else -0.22)
                self._place.at_wall(fittings.socket(self._rng, "switch"), hole.wall, side)
        for _ in range(self._rng.integers(2, 6)):
            self._place.along_wall(fittings.socket(self._rng, "socket"), 0.2)
        if self._rng.random() < 0.3:
            self._place.along_wall(fittings.socket(self._rng, "duct"), 0.1)

    def add_something(self) -> None:
        """Add one thing of any sort, if there is room."""
        ways = (self.add_wall_item, self.add_wall_item, self.add_free_item, self.add_picture, self.add_corner_item)
        ways[self._rng.integers(len(ways))]()

    def add_wall_item(self) -> None:
        """Put one large thing against a wall, if there is room."""
        thing = self._builders[self._rng.integers(len(self._builders))](self._rng, self._style)
        if self._place.along_wall(thing) and thing.name == "desk":
            self._chair_in_front(self.objects[-1])

    def add_free_item(self) -> None:
        """Put a table with its chairs, a single chair or boxes anywhere on the floor, if there is room."""
        thing = _FREE[self._rng.integers(len(_FREE))](self._rng, self._style)
        is_table = thing.name == "table"
        if self._place.on_floor(thing, 0.7 if is_table else 0.3) and is_table:
            self._chairs_around(self.objects[-1])

    def add_corner_item(self) -> None:
        """Put a plant or a lamp near a corner, if there is room."""
        build = (decoration.plant, decoration.plant, decoration.floor_lamp)[self._rng.integers(3)]
        self._place.near_corner(build(self._rng, self._style))

    def add_rug(self) -> None:
        """Lay one rug, if it fits."""
        width, depth = self._room.size_m
        self._place.on_floor(decoration.rug(self._rng, self._style, (width * 0.7, depth * 0.7)), 0.1)

    def add_picture(self) -> None:
        """Hang one picture, if there is room."""
        self._place.along_wall(decoration.wall_picture(self._rng, self._style), 0.06)

    def add_again(self, thing: Item) -> None:
        """Put a thing that stood elsewhere at a new place, if there is room."""
        if thing.anchor in ("middle", "floor"):
            self._place.on_floor(thing, 0.05)
        else:
            self._place.along_wall(thing)

    def _dress_window(self, wall: int, start: float, width: float, sill: float, top: float) -> None:
        if sill > 0.7 and self._rng.random() < 0.7:
            heater = decoration.radiator(self._rng, width * self._rng.uniform(0.6, 1.0))
            self._place.at_wall(heater, wall, start + width / 2)
        if self._rng.random() < 0.45:
            height = min(top + 0.2, self._room.height_m - 0.02)
            for side in (start - 0.3, start + width + 0.3):
                self._place.at_wall(decoration.curtain(self._rng, self._style, height), wall, side)

    def _chairs_around(self, table: SceneObject) -> None:
        area = table.footprint
        assert area is not None
        seat = furniture.chair(self._rng, self._style)
        middle_x, middle_y = (area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2
        reach = self._rng.uniform(0.3, 0.5)
        spots = [(area.x0 - reach, middle_y, -np.pi / 2), (area.x1 + reach, middle_y, np.pi / 2)]
        spots += [(middle_x, area.y0 - reach, 0.0), (middle_x, area.y1 + reach, np.pi)]
        for x, y, yaw in spots:
            if self._rng.random() < 0.75:
                self._place.at(seat, yaw + self._rng.normal(0, 0.15), x, y)

    def _chair_in_front(self, desk: SceneObject) -> None:
        area, room = desk.footprint, self._room
        assert area is not None
        middle = np.array([(area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2])
        center = np.array([(room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2])
        wide = area.x1 - area.x0 > area.y1 - area.y0
        away = np.array([0, 1.0]) if wide else np.array([1.0, 0])
        away = away * np.sign((center - middle) @ away or 1.0)
        x, y = middle + away * (min(area.x1 - area.x0, area.y1 - area.y0) / 2 + 0.55)
        seat = furniture.chair(self._rng, self._style)
        self._place.at(seat, float(np.arctan2(-away[1], -away[0])) - np.pi / 2, x, y)
