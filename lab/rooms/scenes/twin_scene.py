"""Rooms that are alike: places in which one picture has several right poses, or nearly right ones."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style
from panoloc.lab.rooms.objects.furnishing import Furnisher
from panoloc.lab.rooms.objects.objects import Footprint, Light, SceneObject
from panoloc.lab.rooms.objects.room_shell import Opening, Room, build_shell
from panoloc.lab.rooms.objects.solids import Part
from panoloc.lab.rooms.scenes.room_scene import furnished, random_room
from panoloc.lab.rooms.scenes.scene import Scene, Twins

_GAP_M = 0.5
_CORRIDOR_M = 1.7
_MIRROR = np.array([-1.0, 1, 1])
_OTHER_SIDE = {0: 0, 1: 3, 2: 2, 3: 1}  # walls across x change sides


def equal_rooms(rng: Rng, style: Style, area_m2: float | None, count: int) -> Scene:
    """Return `count` furnished rooms in a row along x, exact copies of the first."""
    first = random_room(rng, area_m2 or float(rng.uniform(9, 25)))
    shift = first.size_m[0] + _GAP_M
    rooms = tuple(replace(first, x0=first.x0 + k * shift, x1=first.x1 + k * shift) for k in range(count))
    states = [deepcopy(rng) for _ in rooms[1:]]
    objects = furnished(rng, style, first, 0)
    for number, (room, again) in enumerate(zip(rooms[1:], states, strict=True), 1):
        objects += furnished(again, style, room, number)
    return Scene(tuple(objects), rooms, style, twins=Twins(rooms, (False,) * count, equal=True))


def repeated_rooms(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return three exact copies of a furnished room in a row, and the corridor along them, behind closed doors."""
    rooms = equal_rooms(rng, style, area_m2, 3)
    assert rooms.twins is not None
    first, last = rooms.rooms[0], rooms.rooms[-1]
    end = first.y0 - _GAP_M
    doors = tuple(Opening(2, room.x0 + 0.4 - first.x0, 0.85, 0.0, 2.05, "door") for room in rooms.rooms)
    corridor = Room(first.x0, end - _CORRIDOR_M, last.x1, end, first.height_m, doors)
    shell = build_shell(rng, style, corridor, "corridor")
    furnisher = Furnisher(rng, style, corridor, len(rooms.rooms), shell, "hall")
    furnisher.furnish(style.density)
    return replace(rooms, objects=(*rooms.objects, *shell, *furnisher.objects), rooms=(*rooms.rooms, corridor))


def nearly_twin_rooms(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return a furnished room and a copy of it in which one or two things or pictures are others."""
    same = equal_rooms(rng, style, area_m2, 2)
    assert same.twins is not None
    movable = [thing for thing in same.objects if thing.room == 1 and thing.movable]
    chosen = rng.permutation(len(movable))[: int(rng.integers(1, 3))]
    gone = {movable[number].key for number in chosen}
    kept = [thing for thing in same.objects if thing.key not in gone]
    there = [thing for thing in kept if _is_inside(thing, same.rooms[1])]
    furnisher = Furnisher(rng, style, same.rooms[1], 1, there)
    for _ in chosen:
        add = furnisher.add_picture if rng.random() < 0.5 else furnisher.add_something
        add()
    return replace(same, objects=(*kept, *furnisher.objects), twins=replace(same.twins, equal=False))


def mirrored_rooms(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return a furnished room and its mirror image beside it."""
    first = random_room(rng, area_m2 or float(rng.uniform(9, 25)))
    plane_x = first.x1 + _GAP_M / 2
    objects = furnished(rng, style, first, 0)
    rooms = first, mirrored_room(first, plane_x)
    both = (*objects, *(_mirrored_object(thing, plane_x, 1) for thing in objects))
    return Scene(both, rooms, style, twins=Twins(rooms, mirrored=(False, True), equal=False))


def twin_poses(scene: Scene, pose: Pose) -> tuple[Pose, ...]:
    """Return the poses in the other rooms of a scene of twins that see the same, or what is most alike; none for all other scenes.

    In a mirrored room it is the mirrored view: as far from the mirrored walls, and looking at them.
    """
    if scene.twins is None:
        return ()
    own = scene.twins.number_at(pose.position)
    if own is None:
        return ()
    at_first = _moved(pose, scene.twins, own, back=True)
    others = (number for number in range(len(scene.twins.rooms)) if number != own)
    return tuple(_moved(at_first, scene.twins, number, back=False) for number in others)


def _is_inside(thing: SceneObject, room: Room) -> bool:
    vertices = np.concatenate([part.vertices for piece in thing.pieces for part in piece.parts])
    middle = (vertices.min(0) + vertices.max(0)) / 2
    return bool(room.x0 - _GAP_M / 2 < middle[0] < room.x1 + _GAP_M / 2)


def _moved(pose: Pose, twins: Twins, number: int, *, back: bool) -> Pose:
    """Return the pose of the first room moved into that room, or back from it."""
    first, room = twins.rooms[0], twins.rooms[number]
    if twins.mirrored[number]:  # its own inverse
        plane_x = (first.x0 + room.x1) / 2
        position = pose.position * _MIRROR + np.array([2 * plane_x, 0, 0])
        return Pose(np.diag(_MIRROR) @ pose.rotation @ np.diag((1.0, -1, 1)), position)
    shift = np.array([room.x0 - first.x0, 0, 0])
    return Pose(pose.rotation, pose.position - shift if back else pose.position + shift)


def mirrored_room(room: Room, plane_x: float) -> Room:
    """Return the room on the other side of the plane x = `plane_x`, with its openings."""
    openings = tuple(_mirrored_opening(hole, room.wall_length_m(hole.wall)) for hole in room.openings)
    return replace(room, x0=2 * plane_x - room.x1, x1=2 * plane_x - room.x0, openings=openings)


def _mirrored_opening(hole: Opening, length_m: float) -> Opening:
    # A wall starts at its left end as seen from inside, which the mirror makes its right end.
    return replace(hole, wall=_OTHER_SIDE[hole.wall], start_m=length_m - hole.start_m - hole.width_m)


def _mirrored_object(thing: SceneObject, plane_x: float, number: int) -> SceneObject:
    """Return the thing on the other side of the plane, as one of the room with that number, under a key of its own."""
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
