"""The mirror image of a room in a plane across x: its walls, its furniture and its lights."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lab.rooms.objects.objects import Footprint, Light, SceneObject
from lab.rooms.objects.room_shell import Opening, Room
from lab.rooms.objects.solids import Part

_OTHER_SIDE = {0: 0, 1: 3, 2: 2, 3: 1}  # walls across x change sides


def mirrored_room(room: Room, plane_x: float) -> Room:
    """Return the room on the other side of the plane x = `plane_x`, with its openings."""
    openings = tuple(_mirrored_opening(hole, room.wall_length_m(hole.wall)) for hole in room.openings)
    return replace(room, x0=2 * plane_x - room.x1, x1=2 * plane_x - room.x0, openings=openings)


def mirrored_objects(objects: Sequence[SceneObject], plane_x: float, number: int) -> list[SceneObject]:
    """Return the objects on the other side of the plane, as things of the room with that number, under keys of their own."""
    return [_mirrored_object(thing, plane_x, number) for thing in objects]


def _mirrored_opening(hole: Opening, length_m: float) -> Opening:
    # A wall starts at its left end as seen from inside, which the mirror makes its right end.
    return replace(hole, wall=_OTHER_SIDE[hole.wall], start_m=length_m - hole.start_m - hole.width_m)


def _mirrored_object(thing: SceneObject, plane_x: float, number: int) -> SceneObject:
    pieces = tuple(
        replace(piece, parts=tuple(_mirrored_part(part, plane_x) for part in piece.parts)) for piece in thing.pieces
    )
    area = thing.footprint
    return replace(
        thing,
        key=f"mirrored/{thing.key}",
        pieces=pieces,
        footprint=area and Footprint(2 * plane_x - area.x1, area.y0, 2 * plane_x - area.x0, area.y1),
        room=number,
        lights=tuple(_mirrored_light(light, plane_x) for light in thing.lights),
        hinge=thing.hinge and (2 * plane_x - thing.hinge[0], thing.hinge[1]),
    )


def _mirrored_part(part: Part, plane_x: float) -> Part:
    # Corners in the other order, so that normals still point out of the solid.
    return replace(part, vertices=_mirrored_points(part.vertices, plane_x), triangles=part.triangles[:, ::-1].copy())


def _mirrored_light(light: Light, plane_x: float) -> Light:
    normal = None if light.normal is None else light.normal * (-1, 1, 1)
    return replace(light, points=_mirrored_points(light.points, plane_x), normal=normal)


def _mirrored_points(points: NDArray[np.float64], plane_x: float) -> NDArray[np.float64]:
    return np.asarray(points * (-1, 1, 1) + np.array([2 * plane_x, 0, 0]))
