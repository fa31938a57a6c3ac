"""Heading, elevation and roll of a photo as photographers mean them, in a frame whose y axis is north and z axis up.

Convention: rotation = Rz(90° − heading) · Ry(−elevation) · Rx(roll). Heading is clockwise from north, elevation up,
roll right side down.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_AT_THE_POLE = 1e-9  # radians; nearer to it than that heading and roll are one turn


@dataclass(frozen=True)
class PhotoAngles:
    """Degrees; heading_deg in [0, 360), elevation_deg in [−90, 90], roll_deg in (−180, 180], 0 at the poles."""

    heading_deg: float
    elevation_deg: float
    roll_deg: float


def photo_angles(rotation: NDArray[np.float64]) -> PhotoAngles:
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
