"""Poses, and the frames in which they leave the service.

Convention: `map_from_camera` maps camera coordinates (x forward, y left, z up) to map coordinates,
`x_map = rotation · x_camera + position`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import OptionsError
from panoloc.core.options import Frame

FRAMES: tuple[Frame, ...] = get_args(Frame)

# Rows are the axes of the other camera frame written in the FLU camera frame.
_CAMERA_AXES: dict[str, NDArray[np.float64]] = {
    "ros": np.eye(3),
    "opencv": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "webxr": np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]),
    "unity": np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]]),
}
# Map axes: webxr and unity have y up. webxr (x, y, z) = (x, z, −y) of the map; unity (left-handed) = (x, z, y): of a map that is east,
# north, up it makes x east, y up, z north.
_MAP_AXES: dict[str, NDArray[np.float64]] = {
    "ros": np.eye(3),
    "opencv": np.eye(3),
    "webxr": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "unity": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
}


@dataclass(frozen=True)
class Pose:
    """A pose `map_from_camera`.

    rotation: (3, 3) float64, orthonormal. position: (3,) float64, metres, the camera centre in the map frame.
    """

    rotation: NDArray[np.float64]
    position: NDArray[np.float64]

    def in_frame(self, frame: Frame) -> "Pose":
        """Return the same pose with map and camera axes of `frame`.

        `ros` FLU; `opencv` camera x right, y down, z forward, map unchanged; `webxr` both y up, −z forward;
        `unity` left-handed, y up. Raises OptionsError for any other name.
        """
        camera, world = _axes_of(frame)
        return Pose(world @ self.rotation @ camera.T, world @ self.position)

    def between_worlds(self, frame: Frame) -> "Pose":
        """Return a pose that maps one world (z up) to another, such as `map_from_session`, with both in the axes of `frame`.

        Raises OptionsError for any other name of a frame.
        """
        _, world = _axes_of(frame)
        return Pose(world @ self.rotation @ world.T, world @ self.position)

    @classmethod
    def from_frame(cls, position: Sequence[float], quaternion_xyzw: Sequence[float], frame: Frame) -> "Pose":
        """Return the pose that `in_frame(frame)` would give as this position (metres) and unit quaternion.

        Raises OptionsError for any other name of a frame.
        """
        camera, world = _axes_of(frame)
        quaternion = np.asarray(quaternion_xyzw, np.float64)
        rotation = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))
        return cls(world.T @ rotation @ camera, world.T @ np.asarray(position, np.float64))

    def after(self, first: "Pose") -> "Pose":
        """Return the pose that maps by `first` and then by this one: `a_from_b.after(b_from_c)` is `a_from_c`."""
        return Pose(self.rotation @ first.rotation, self.rotation @ first.position + self.position)

    def inverse(self) -> "Pose":
        """Return the pose that maps back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.position)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Return the homogeneous (4, 4) matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix

    @property
    def quaternion_xyzw(self) -> NDArray[np.float64]:
        """Return the unit quaternion (x, y, z, w) with w >= 0."""
        return quaternion_of(self.rotation)

    @property
    def yaw_pitch_roll(self) -> tuple[float, float, float]:
        """Return radians with rotation = Rz(yaw) · Ry(pitch) · Rx(roll); at the pole roll is zero."""
        r = self.rotation
        pitch = float(np.arcsin(np.clip(-r[2, 0], -1, 1)))
        if abs(r[2, 0]) > 1 - 1e-9:
            return float(np.arctan2(-r[0, 1], r[1, 1])), pitch, 0.0
        return float(np.arctan2(r[1, 0], r[0, 0])), pitch, float(np.arctan2(r[2, 1], r[2, 2]))


def _axes_of(frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the axes of cameras and of maps in a frame, each (3, 3). Raises OptionsError for any other name."""
    if frame not in FRAMES:
        raise OptionsError(f"frame: expected one of {', '.join(FRAMES)}, got {frame!r}")
    return _CAMERA_AXES[frame], _MAP_AXES[frame]


def matrix_from_quaternion(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4) in the order x, y, z, w."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation matrix.

    The eigenvector route has no singular branch (Bar-Itzhack 2000).
    """
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    q: NDArray[np.float64] = np.linalg.eigh(k)[1][:, -1]
    return q if q[3] >= 0 else -q


@dataclass(frozen=True)
class PoseError:
    """How far a pose is from the known one: metres between camera centres, degrees between orientations."""

    position_m: float
    orientation_deg: float

    def within(self, position_m: float, orientation_deg: float) -> bool:
        """Tell whether both errors are at most the given limits."""
        return self.position_m <= position_m and self.orientation_deg <= orientation_deg


def pose_error(found: Pose, known: Pose) -> PoseError:
    """Return the distance of the camera centres and the angle between the orientations."""
    cosine = (np.trace(found.rotation.T @ known.rotation) - 1) / 2
    return PoseError(
        float(np.linalg.norm(found.position - known.position)), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    )
