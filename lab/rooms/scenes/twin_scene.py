"""Two equal rooms side by side: a place in which one picture has two right poses."""

from copy import deepcopy
from dataclasses import replace

import numpy as np

from core.geometry.pose import Pose
from lab.rooms.materials.patterns import Rng
from lab.rooms.materials.style import Style
from lab.rooms.scenes.room_scene import furnished, random_room
from lab.rooms.scenes.scene import Scene

_GAP_M = 0.5


def twin_rooms(rng: Rng, style: Style, area_m2: float | None) -> Scene:
    """Return a furnished room and its exact copy, shifted along x."""
    first = random_room(rng, area_m2 or float(rng.uniform(9, 25)))
    shift = first.size_m[0] + _GAP_M
    second = replace(first, x0=first.x0 + shift, x1=first.x1 + shift)
    again = deepcopy(rng)
    objects = (*furnished(rng, style, first, 0), *furnished(again, style, second, 1))
    return Scene(objects, (first, second), style, twins=True)


def twin_poses(scene: Scene, pose: Pose) -> tuple[Pose, ...]:
    """Return the poses in the other rooms of a scene of twins that see the same; nothing for all other scenes."""
    if not scene.twins:
        return ()
    inside = [room.x0 <= pose.position[0] <= room.x1 for room in scene.rooms]
    own = scene.rooms[inside.index(True)]
    return tuple(
        Pose(pose.rotation, pose.position + np.array([room.x0 - own.x0, 0, 0]))
        for room in scene.rooms
        if room is not own
    )
