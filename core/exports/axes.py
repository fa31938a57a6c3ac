"""Axes of other systems; a new orientation is `world_axes · rotation · camera_axesᵀ`.

Source: the conventions of each format; camera coordinates of ours are x forward, y left, z up, worlds have z up.
"""

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose, quaternion_of

Matrix = NDArray[np.float64]

CV_FROM_FLU: Matrix = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""x right, y down, z forward: COLMAP, OpenSfM, Metashape."""

GL_FROM_FLU: Matrix = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
"""x right, y up, z backward: glTF, nerfstudio, STAC."""

Y_UP_FROM_Z_UP: Matrix = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""(x, z, −y): worlds of glTF."""


def cam_from_world(map_from_camera: Pose) -> Pose:
    """Return the pose as reconstructions have it: from the map to a camera with axes right, down, forward."""
    rotation = CV_FROM_FLU @ map_from_camera.rotation.T
    return Pose(rotation, -rotation @ map_from_camera.position)


def quaternion_wxyz(rotation: Matrix) -> list[float]:
    """Return the unit quaternion with w first, w >= 0."""
    x, y, z, w = quaternion_of(rotation).tolist()
    return [w, x, y, z]
