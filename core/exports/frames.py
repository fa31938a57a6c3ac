"""Axes and angles of other systems: of cameras, worlds, and photographers.

Camera coordinates of ours are x forward, y left, z up; worlds have z up. A new orientation is
`world_axes · rotation · camera_axesᵀ`. Source of the axes: the conventions of each format.
"""

import math
from dataclasses import dataclass

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

_AT_THE_POLE = 1e-9  # radians; nearer to it than that heading and roll are one turn


@dataclass(frozen=True)
class PhotoAngles:
    """Heading, elevation and roll as photographers mean them, in degrees, in a frame with y north and z up.

    Convention: rotation = Rz(90° − heading) · Ry(−elevation) · Rx(roll). heading_deg in [0, 360), clockwise from north;
    elevation_deg in [−90, 90], up; roll_deg in (−180, 180], right side down, 0 at the poles.
    """

    heading_deg: float
    elevation_deg: float
    roll_deg: float


def cam_from_world(map_from_camera: Pose) -> Pose:
    """Return the pose as reconstructions have it: from the map to a camera with axes right, down, forward."""
    rotation = CV_FROM_FLU @ map_from_camera.rotation.T
    return Pose(rotation, -rotation @ map_from_camera.position)


def quaternion_wxyz(rotation: Matrix) -> list[float]:
    """Return the unit quaternion with w first, w >= 0."""
    x, y, z, w = quaternion_of(rotation).tolist()
    return [w, x, y, z]


def photo_angles(rotation: Matrix) -> PhotoAngles:
    """Return the angles of a rotation (3, 3) from camera (x forward, y left, z up) to a world with y north and z up."""
    r = rotation
    level = math.hypot(r[0, 0], r[1, 0])
    elevation = math.atan2(r[2, 0], level)
    if level < _AT_THE_POLE:
        yaw, roll = math.atan2(-r[0, 1], r[1, 1]), 0.0
    else:
        yaw, roll = math.atan2(r[1, 0], r[0, 0]), math.atan2(r[2, 1], r[2, 2])
    # A heading a rounding error below zero would be written as 360.
    heading = round((90.0 - math.degrees(yaw)) % 360.0, 10) % 360.0
    return PhotoAngles(heading, math.degrees(elevation), 180.0 if roll <= -math.pi else math.degrees(roll))
