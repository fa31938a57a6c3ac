"""Rigid motions, named target first: `a_from_b` maps coordinates in b to coordinates in a."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """x_target = rotation · x_source + position. rotation: (3, 3). position: (3,), metres."""

    rotation: Array
    position: Array

    def __matmul__(self, other: "Pose") -> "Pose":
        """Return a_from_c of a_from_b and b_from_c."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.position + self.position)

    def inverse(self) -> "Pose":
        """Return the motion back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.position)

    @property
    def xyzw(self) -> tuple[float, float, float, float]:
        """Return the unit quaternion, w not negative."""
        R = self.rotation
        xx, yy, zz = np.diag(R)
        # Bar-Itzhack 2000: the eigenvector of the largest eigenvalue; it never divides by little.
        K = [
            [xx - yy - zz, 0, 0, 0],
            [R[0, 1] + R[1, 0], yy - xx - zz, 0, 0],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], zz - xx - yy, 0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], xx + yy + zz],
        ]
        x, y, z, w = (float(each) for each in np.linalg.eigh(np.array(K))[1][:, 3])
        sign = math.copysign(1.0, w)
        return sign * x, sign * y, sign * z, sign * w

    @property
    def flat(self) -> "Pose":
        """Return the nearest motion in the plane: x, y and yaw."""
        yaw = math.atan2(self.rotation[1, 0], self.rotation[0, 0])
        return Pose(turned((0.0, 0.0, yaw)), np.array([*self.position[:2], 0.0]))

    def moved_towards(self, other: "Pose", share: float, turn_share: float) -> "Pose":
        """Return the pose between both, at these shares of the way and of the turn."""
        x, y, z, w = (self.inverse() @ other).xyzw
        sine = math.hypot(x, y, z)
        angle = 2 * math.atan2(sine, w) * turn_share / sine if sine > 1e-12 else 0.0
        rotation = self.rotation @ turned((angle * x, angle * y, angle * z))
        return Pose(rotation, self.position + share * (other.position - self.position))


def turned(vector: tuple[float, float, float]) -> Array:
    """Return the rotation (3, 3) about a vector by its length, radians."""
    angle = math.hypot(*vector)
    sine = math.sin(angle / 2) / angle if angle > 1e-12 else 0.5
    x, y, z = (sine * each for each in vector)
    return rotation_of(x, y, z, math.cos(angle / 2))


def rotation_of(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation (3, 3) of a quaternion of any length but 0."""
    x, y, z, w = np.array((x, y, z, w)) / math.hypot(x, y, z, w)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_of(position: Any, quaternion: Any) -> Pose:
    """Return the pose of two objects with x, y, z and x, y, z, w."""
    rotation = rotation_of(quaternion.x, quaternion.y, quaternion.z, quaternion.w)
    return Pose(rotation, np.array([position.x, position.y, position.z], np.float64))


def is_motion(transform: Any) -> bool:
    """Tell whether a transform of ROS is a motion: all its numbers finite, and a quaternion that is not zero."""
    turn = [getattr(transform.rotation, axis) for axis in "xyzw"]
    way = [getattr(transform.translation, axis) for axis in "xyz"]
    return all(map(math.isfinite, (*turn, *way))) and math.hypot(*turn) > 1e-6


def as_json(pose: Pose) -> dict[str, dict[str, float]]:
    """Return the pose as the HTTP API takes it."""
    return {
        "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", pose.xyzw, strict=True)),
    }


def from_json(found: dict[str, dict[str, float]]) -> Pose:
    """Return the pose of an answer."""
    position, quaternion = found["position_m"], found["quaternion"]
    return Pose(rotation_of(**quaternion), np.array([position[axis] for axis in "xyz"]))


def distance_between(a: Pose, b: Pose) -> tuple[float, float]:
    """Return metres and radians between two poses."""
    x, y, z, w = (a.inverse() @ b).xyzw
    return float(np.linalg.norm(a.position - b.position)), 2 * math.atan2(math.hypot(x, y, z), w)
