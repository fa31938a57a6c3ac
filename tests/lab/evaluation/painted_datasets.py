"""Writes a painted box in the layouts of the paper's data sets, with matrices made from the sentences of their documentation."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.point_cloud import PointCloud

Matrix = NDArray[np.float64]


def write_text_cloud(path: Path, cloud: PointCloud) -> None:
    """Write lines of x y z red green blue."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.column_stack((cloud.positions.astype(np.float64) + cloud.origin_offset, cloud.colors))
    np.savetxt(path, rows, fmt="%.4f %.4f %.4f %d %d %d")


def write_image(path: Path, color: NDArray[np.uint8]) -> None:
    """Write an image and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(color).save(path)


def write_reference_pose(path: Path, pose: Pose, rows: int = 3) -> None:
    """Write [R | position] of x_camera = R (x_map − position), as the reference implementation reads it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    matrix = np.column_stack((np.linalg.inv(pose.rotation), pose.position))
    np.savetxt(path, np.vstack((matrix, [0, 0, 0, 1]))[:rows])


def world_to_opencv(pose: Pose) -> Matrix:
    """Return the (3, 4) matrix from world to a camera with x right, y down, z forward."""
    axes = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # right is −left, down is −up, forward is forward
    rotation = axes @ pose.rotation.T
    return np.column_stack((rotation, -rotation @ pose.position))


def fixed_axes_angles(rotation: Matrix) -> list[float]:
    """Return (x, y, z) radians with rotation = Rz Ry Rx, away from the pole."""
    return [
        float(np.arctan2(rotation[2, 1], rotation[2, 2])),
        float(np.arcsin(-rotation[2, 0])),
        float(np.arctan2(rotation[1, 0], rotation[0, 0])),
    ]


def write_stanford_pose(path: Path, pose: Pose, with_euler: bool) -> None:
    """Write the JSON of 2D-3D-S; Blender's camera has x right, y up, z back."""
    blender = pose.rotation @ np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
    values: dict[str, object] = {"camera_rt_matrix": world_to_opencv(pose).tolist()}
    if with_euler:
        values["camera_location"] = pose.position.tolist()
        values["final_camera_rotation"] = fixed_axes_angles(blender)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values))
