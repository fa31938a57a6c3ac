"""A street of about 60 m: houses on both sides, road, pavements, parked cars, trees, lamps, and an open sky."""

from collections.abc import Sequence

import numpy as np

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style
from panoloc.lab.rooms.materials.texture import plain
from panoloc.lab.rooms.objects.decoration import person
from panoloc.lab.rooms.objects.objects import Item, Light, Piece, SceneObject, fixed, placed
from panoloc.lab.rooms.objects.placement import turned_footprint
from panoloc.lab.rooms.objects.room_shell import Room
from panoloc.lab.rooms.objects.solids import box, moved, quad
from panoloc.lab.rooms.objects.street_objects import bench, car, facade, lamp_post, sign, tree
from panoloc.lab.rooms.scenes.lighting import Sky
from panoloc.lab.rooms.scenes.scene import Scene

_HALF_LENGTH_M = 32.0
_HALF_ROAD_M = 3.6
_HALF_WIDTH_M = 6.4
_KERB_M = 0.12
# Where a camera can be: the paper's outdoor cuboid of 50 x 10 m.
CAMERA_AREA = Room(-25.0, -5.0, 25.0, 5.0, 5.0)


def street(rng: Rng, style: Style) -> Scene:
    """Return a street along x."""
    sun_angle, sun_height = rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 1.2)
    toward = np.array([np.cos(sun_angle), np.sin(sun_angle), np.tan(sun_height)])
    sun = Light(toward[None], np.array([1.0, 0.94, 0.84]) * rng.uniform(0.8, 1.6), sun=True)
    objects = [*_ground(rng, sun), *_houses(rng)]
    dresser = StreetDresser(rng, ())
    for _ in range(rng.integers(6, 11)):
        dresser.add_again(car(rng))
    for build, low, high in ((tree, 3, 8), (lamp_post, 3, 6), (sign, 2, 5), (bench, 1, 4)):
        for _ in range(rng.integers(low, high)):
            dresser.add_again(build(rng))
    sky = Sky((0.42, 0.62, 1.0), (0.92, 0.96, 1.0))
    return Scene((*objects, *dresser.objects), (CAMERA_AREA,), style, sky, outdoor=True)


class StreetDresser:
    """Puts things on road and pavements without collisions. there: what already stands."""

    def __init__(self, rng: Rng, there: Sequence[SceneObject]) -> None:
        self._rng = rng
        self._taken = [thing.footprint for thing in there if thing.footprint]
        self.objects: list[SceneObject] = []

    def add_again(self, thing: Item) -> None:
        """Find a new place for a thing, if there is room."""
        rng = self._rng
        for _ in range(30):
            side = 1 if rng.random() < 0.5 else -1
            x = rng.uniform(-_HALF_LENGTH_M + 3, _HALF_LENGTH_M - 3)
            if thing.anchor == "road":
                edge = _HALF_ROAD_M - 0.25 - thing.size_m[1]
                yaw, y, z = (0.0 if side > 0 else np.pi) + rng.normal(0, 0.02), side * edge, 0.0
            else:
                yaw, z = (np.pi if side > 0 else 0.0), _KERB_M
                y = side * rng.uniform(_HALF_ROAD_M + 0.5, _HALF_WIDTH_M - 0.9)
            area = turned_footprint(thing, yaw, x, y)
            if not any(area.overlaps(other, 0.5) for other in self._taken):
                self.objects.append(placed(thing, f"{thing.name}@{x:.3f},{y:.3f}", yaw, (x, y, z), area))
                self._taken.append(area)
                return

    def add_something(self) -> None:
        """Add one thing of any sort, if there is room."""
        build = (car, car, bench, sign, _pedestrian)[self._rng.integers(5)]
        self.add_again(build(self._rng))


def _pedestrian(rng: Rng) -> Item:
    somebody = person(rng)
    return Item(somebody.name, somebody.pieces, somebody.size_m, "pavement")


def _ground(rng: Rng, sun: Light) -> list[SceneObject]:
    length = 2 * _HALF_LENGTH_M
    road = patterns.concrete(rng, np.full(3, rng.uniform(0.26, 0.4)), (length / 4, 2 * _HALF_ROAD_M))
    slab_m, tone = rng.uniform(0.3, 0.6), np.full(3, rng.uniform(0.5, 0.68))
    side = _HALF_WIDTH_M - _HALF_ROAD_M
    slabs = patterns.tiles(rng, tone, tone * 0.93, (12 * slab_m, 6 * slab_m), slab_m)
    surface = [quad((-_HALF_LENGTH_M, -_HALF_ROAD_M, 0), (length, 0, 0), (0, 2 * _HALF_ROAD_M, 0), road, step_m=0.8)]
    white = plain((0.85, 0.85, 0.83))
    for x in np.arange(-_HALF_LENGTH_M + 1, _HALF_LENGTH_M - 3, 4.5):
        surface += box((2.0, 0.12, 0.004), white, (float(x), 0, 0), skip=("bottom",))
    for _ in range(rng.integers(3, 8)):
        spot = (rng.uniform(-28, 28), rng.uniform(-2.5, 2.5), 0.0)
        surface += box((0.6, 0.6, 0.005), plain((0.2, 0.19, 0.18)), spot, skip=("bottom",))
    pavement = []
    for sign_y in (-1, 1):
        low = min(sign_y * _HALF_ROAD_M, sign_y * _HALF_WIDTH_M)
        pavement.append(quad((-_HALF_LENGTH_M, low, _KERB_M), (length, 0, 0), (0, side, 0), slabs, step_m=0.7))
        kerb = box((length, 0.14, _KERB_M + 0.002), plain((0.6, 0.6, 0.6)), (0, sign_y * (_HALF_ROAD_M + 0.05), 0))
        pavement += kerb
    return [fixed("road", "road", surface, (sun,)), fixed("pavement", "pavement", pavement)]


def _houses(rng: Rng) -> list[SceneObject]:
    houses = []
    for side in (-1, 1):
        x = -_HALF_LENGTH_M
        while x < _HALF_LENGTH_M - 4:
            width = min(rng.uniform(6, 13), _HALF_LENGTH_M - x)
            if rng.random() < 0.12:
                houses.append(_garden(rng, x, width * 0.6, side))
                x += width * 0.6
                continue
            yaw = 0.0 if side < 0 else np.pi
            at = (x + width / 2, side * _HALF_WIDTH_M, 0.0)
            pieces = tuple(
                Piece(piece.label, tuple(moved(piece.parts, yaw, at)))
                for piece in facade(rng, width, rng.uniform(6, 13))
            )
            houses.append(SceneObject(f"house@{x:.2f},{side}", pieces))
            x += width
    return houses


def _garden(rng: Rng, x: float, width: float, side: int) -> SceneObject:
    """Return a gap between houses: a wall with bushes behind it."""
    middle, behind = x + width / 2, side * (_HALF_WIDTH_M + 2.5)
    brick = patterns.bricks(rng, (0.5, 0.36, 0.3))
    parts = box((width, 0.3, rng.uniform(1.6, 2.4)), brick, (middle, side * (_HALF_WIDTH_M + 0.2), 0), step_m=0.6)
    green = artwork.foliage(rng, (0.24, 0.38, 0.16), (1.5, 1.5))
    hedge = box((width, 2.0, rng.uniform(2.5, 4.5)), green, (middle, behind, 0), step_m=0.6)
    return SceneObject(f"garden@{x:.2f},{side}", (Piece("building", tuple(parts)), Piece("tree", tuple(hedge))))
