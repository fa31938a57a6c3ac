"""Things in a scene: pieces of surface with labels, the light they give, and the floor area they stand on."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.objects.solids import Part, about_z, moved


@dataclass(frozen=True, eq=False)
class Light:
    """Light from a small area, sampled at points.

    points: (K, 3) metres, a little in front of what glows. normal: (3,) for light to one side only, None for all sides.
    sun: the first point is the direction towards a far sun instead.
    power: (3,) linear RGB; a surface at 1 m facing the light receives about this much.
    """

    points: NDArray[np.float64]
    power: NDArray[np.float64]
    normal: NDArray[np.float64] | None = None
    sun: bool = False


@dataclass(frozen=True, eq=False)
class Piece:
    """Surface of one object class."""

    label: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Footprint:
    """Area on the floor that a thing occupies, axis-aligned, metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    def overlaps(self, other: "Footprint", gap: float = 0.0) -> bool:
        """Return whether the two areas come closer than `gap` metres."""
        apart_x = self.x0 - gap >= other.x1 or other.x0 - gap >= self.x1
        apart_y = self.y0 - gap >= other.y1 or other.y0 - gap >= self.y1
        return not (apart_x or apart_y)


@dataclass(frozen=True, eq=False)
class Item:
    """A thing in its own frame: origin on the floor at the middle of its back, +y towards its front.

    size_m: width (x), depth (y), height (z). anchor: where it goes, "wall", "middle", "corner",
    "hung", "floor" or "ceiling". fixture: belongs to the building, so it never moves.
    """

    name: str
    pieces: tuple[Piece, ...]
    size_m: tuple[float, float, float]
    anchor: str
    lights: tuple[Light, ...] = ()
    fixture: bool = False


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A thing at its place in the map frame. Two objects with the same key are the same thing at the same place.

    hinge: (x, y) around which a door leaf turns; it closes counter-clockwise seen from above.
    """

    key: str
    pieces: tuple[Piece, ...]
    movable: bool = False
    footprint: Footprint | None = None
    item: Item | None = None
    room: int = 0
    lights: tuple[Light, ...] = ()
    hinge: tuple[float, float] | None = None


def placed(
    item: Item, key: str, yaw: float, position: tuple[float, float, float], footprint: Footprint | None, room: int = 0
) -> SceneObject:
    """Return the item as an object turned by `yaw` radians with its origin at `position`."""
    pieces = tuple(replace(piece, parts=tuple(moved(piece.parts, yaw, position))) for piece in item.pieces)
    lights = tuple(_moved_light(light, yaw, position) for light in item.lights)
    return SceneObject(key, pieces, not item.fixture, footprint, item, room, lights)


def fixed(key: str, label: str, parts: Iterable[Part], lights: tuple[Light, ...] = ()) -> SceneObject:
    """Return an object that belongs to the building."""
    return SceneObject(key, (Piece(label, tuple(parts)),), lights=lights)


def _moved_light(light: Light, yaw: float, position: tuple[float, float, float]) -> Light:
    turn = about_z(yaw)
    normal = None if light.normal is None else turn @ light.normal
    return Light(light.points @ turn.T + np.asarray(position), light.power, normal)
