"""A painted box that looks the same after half a turn, and the pose that sees the same as POSE from the other side."""

import numpy as np

from panoloc.core.geometry.pose import Pose
from tests.core.built_maps import POSE
from tests.core.painted_box import PaintedBox, rotation_of

BOX = PaintedBox(seed=3, symmetric=True)
_HALF_TURN, _MIDDLE = rotation_of(180.0), np.array([BOX.size_m[0], BOX.size_m[1], 0.0]) / 2


def seen_from_the_other_side(pose: Pose) -> Pose:
    """Return the pose that sees the same as this one from the other side of the box."""
    return Pose(_HALF_TURN @ pose.rotation, _HALF_TURN @ (pose.position - _MIDDLE) + _MIDDLE)


TWIN = seen_from_the_other_side(POSE)
