"""Other map frames: scans turned about the vertical and given in survey coordinates."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.geometry.pose import Pose
from core.scan.point_cloud import PointCloud


def turned_cloud(cloud: PointCloud, yaw: float, offset_m: NDArray[np.float64]) -> PointCloud:
    """Return the cloud turned by `yaw` radians about z; `offset_m` (3,) becomes its origin offset (float64)."""
    turned = cloud.positions.astype(np.float64) @ _turn(yaw).T
    return replace(cloud, positions=turned.astype(np.float32), origin_offset=np.asarray(offset_m, np.float64))


def turned_pose(pose: Pose, yaw: float, offset_m: NDArray[np.float64]) -> Pose:
    """Return the pose in the frame that `turned_cloud` gives, offset included."""
    turn = _turn(yaw)
    return Pose(turn @ pose.rotation, turn @ pose.position + offset_m)


def survey_frame(rng: np.random.Generator) -> tuple[float, NDArray[np.float64]]:
    """Draw a yaw in radians and an offset in metres like those of UTM coordinates."""
    return float(rng.uniform(-np.pi, np.pi)), rng.uniform((3e5, 5.2e6, 50.0), (6e5, 5.9e6, 600.0))


def _turn(yaw: float) -> NDArray[np.float64]:
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
