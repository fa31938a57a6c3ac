"""A scene: its objects, its baked light, and the free space in which a camera can stand."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.materials.style import Style
from panoloc.lab.rooms.objects.objects import SceneObject
from panoloc.lab.rooms.objects.room_shell import Room
from panoloc.lab.rooms.scenes.lighting import Sky, bake_light, exposure_of
from panoloc.lab.rooms.scenes.surface import Surface, assemble


@dataclass(frozen=True, eq=False)
class Twins:
    """Rooms that are alike, in a row along x.

    mirrored: per room, the mirror image of the first one. equal: what is seen in one is seen in all others exactly.
    """

    rooms: tuple[Room, ...]
    mirrored: tuple[bool, ...]
    equal: bool

    def number_at(self, position: NDArray[np.float64]) -> int | None:
        """Return the number of the room at a position (3,), None outside of all."""
        x, y = position[:2]
        inside = [room.x0 <= x <= room.x1 and room.y0 <= y <= room.y1 for room in self.rooms]
        return inside.index(True) if any(inside) else None


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects with exact places, metres, z up, floor at z = 0.

    rooms: rectangles in which a camera can stand. sky: light where nothing is hit. exposed_like: the scene whose exposure
    this one keeps (a changed scene keeps that of the scene it came from), None to choose it from the scene itself.
    outdoor: a street, where cars and not sofas change. twins: rooms that are alike.
    """

    objects: tuple[SceneObject, ...]
    rooms: tuple[Room, ...]
    style: Style
    sky: Sky = field(default_factory=Sky)
    exposed_like: "Scene | None" = field(default=None, repr=False)
    outdoor: bool = False
    twins: Twins | None = None

    @cached_property
    def surface(self) -> Surface:
        """Return all triangles."""
        return assemble(self.objects)

    @cached_property
    def irradiance(self) -> NDArray[np.float32]:
        """Return the linear RGB light (V, 3) arriving at every vertex of `surface`."""
        lights = [light for thing in self.objects for light in thing.lights]
        return bake_light(self.surface, lights, self.sky)

    @cached_property
    def exposure(self) -> float:
        """Return the factor from reflected light to linear image values."""
        if self.exposed_like is not None:
            return self.exposed_like.exposure
        return exposure_of(self.surface, self.irradiance)

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the key of every object, in the order of `surface.object_index`."""
        return tuple(thing.key for thing in self.objects)


def kept_objects(scene: Scene, other: Scene) -> NDArray[np.bool_]:
    """Return for each object of `scene` whether the same thing stands at the same place in `other`."""
    there = set(other.keys)
    return np.array([key in there for key in scene.keys])


def unique_objects(objects: Sequence[SceneObject]) -> tuple[SceneObject, ...]:
    """Return the objects without those whose key came before."""
    return tuple({thing.key: thing for thing in reversed(objects)}.values())[::-1]
