"""Where a camera or scanner can stand."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose, matrix_from_quaternion
from panoloc.lab.rooms.scenes.scene import Scene

RotationKind = Literal["any", "tilted", "upright"]
_CLEARANCE_M = 0.4
_MAX_TILT_DEG = 15.0


def sample_pose(scene: Scene, rng: np.random.Generator, rotation: RotationKind = "any") -> Pose:
    """Draw a camera pose 1.0 to 1.9 m above the floor, at least 0.4 m from every surface."""
    return Pose(random_rotation(rng, rotation), free_position(scene, rng))


def random_rotation(rng: np.random.Generator, kind: RotationKind) -> NDArray[np.float64]:
    """Draw a (3, 3) rotation: "any" uniform on SO(3), "tilted" any yaw and up to 15 degrees of tilt, "upright" any yaw."""
    if kind == "any":
        quaternion = rng.normal(size=4)
        return matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))
    yaw = rng.uniform(-np.pi, np.pi)
    upright = matrix_from_quaternion(np.array([0, 0, np.sin(yaw / 2), np.cos(yaw / 2)]))
    if kind == "upright":
        return upright
    tilt, direction = np.radians(_MAX_TILT_DEG) * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(direction), np.sin(direction), 0]) * np.sin(tilt / 2)
    return matrix_from_quaternion(np.append(axis, np.cos(tilt / 2))) @ upright


def free_position(scene: Scene, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a position 1.0 to 1.9 m above the floor with free space around; the clearance shrinks only if none is found."""
    areas = np.array([room.size_m[0] * room.size_m[1] for room in scene.rooms])
    for attempt in range(50):
        room = scene.rooms[rng.choice(len(areas), p=areas / areas.sum())]
        drawn = rng.uniform((room.x0, room.y0, 1.0), (room.x1, room.y1, 1.9), (64, 3))
        free = np.flatnonzero(scene.surface.clearance(drawn) >= _CLEARANCE_M * 0.95 ** max(0, attempt - 20))
        if len(free):
            return np.asarray(drawn[free[0]], np.float64)
    raise OptionsError("scene: expected free space for a camera, found none; use fewer or smaller objects")


def scanner_positions(scene: Scene, count: int | None, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (N, 3) positions spread over the rooms by area, at least one per room; count None: two and more per room."""
    areas = np.array([room.size_m[0] * room.size_m[1] for room in scene.rooms])
    wanted = np.minimum(2 + areas / 12, 12) if count is None else np.maximum(1, count * areas / areas.sum())
    shares = np.round(wanted).astype(int)
    chosen = []
    for room, share in zip(scene.rooms, shares, strict=True):
        drawn = rng.uniform((room.x0, room.y0, 1.3), (room.x1, room.y1, 1.7), (400, 3))
        clear = scene.surface.clearance(drawn)
        drawn = drawn[np.argsort(-clear)[: max(40, int((clear > 0.35).sum()))]]
        picked = [drawn[0]]
        while len(picked) < share:
            apart = np.min([np.linalg.norm(drawn - other, axis=1) for other in picked], axis=0)
            picked.append(drawn[np.argmax(apart)])
        chosen += picked
    return np.array(chosen)
