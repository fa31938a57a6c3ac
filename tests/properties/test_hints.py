"""Hints are never exceeded, whatever they are."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from panoloc.core.options import Hints
from panoloc.core.search.pose_limits import PoseLimits, pose_limits
from tests.properties.strategies import Array, finite, rotations

OFFSET = np.array([1_000_000.0, -2_000_000.0, 250.0])
MAP = SimpleNamespace(origin_offset=OFFSET)
points = st.tuples(finite(-3, 3), finite(-3, 3), finite(-3, 3)).map(np.array)


def limits_of(hints: Hints) -> PoseLimits:
    """Return the limits of poses in double precision."""
    limits = pose_limits(hints, MAP)  # type: ignore[arg-type]
    return limits.of_rig(torch.eye(3, dtype=torch.float64), torch.zeros(3), None)


@given(points, points, finite(0.1, 4))
def test_a_position_is_allowed_within_the_radius_alone(center: Array, position: Array, radius: float) -> None:
    distance = float(np.linalg.norm(center - position))
    hints = Hints(position_m=tuple((center + OFFSET).tolist()), radius_m=radius)
    allowed = bool(pose_limits(hints, MAP).allows_position(torch.from_numpy(position)))  # type: ignore[arg-type]
    if abs(distance - radius) > 1e-4:
        assert allowed == (distance <= radius)


@given(points, points, points)
def test_a_position_is_allowed_inside_the_region_alone(one: Array, other: Array, position: Array) -> None:
    low, high = np.minimum(one, other), np.maximum(one, other) + 0.01
    corners = tuple((low + OFFSET).tolist()), tuple((high + OFFSET).tolist())
    limits = pose_limits(Hints(region=corners), MAP)  # type: ignore[arg-type]
    margin = np.minimum(position - low, high - position).min()
    if abs(margin) > 1e-4:
        assert bool(limits.allows_position(torch.from_numpy(position))) == (margin > 0)


@given(rotations, finite(0, 180))
def test_a_rotation_is_allowed_within_the_tilt_alone(rotation: Array, tilt: float) -> None:
    found = math.degrees(math.acos(np.clip(rotation[2, 2], -1, 1)))  # the angle between the camera's up and the map's
    limits = limits_of(Hints(max_tilt_deg=tilt))
    if abs(found - tilt) > 1e-3:
        assert bool(limits.allows_rotation(torch.from_numpy(rotation))) == (found <= tilt)


@given(rotations, finite(-720, 720), finite(1, 180))
def test_a_rotation_is_allowed_within_the_heading_alone_unless_it_has_none(
    rotation: Array, heading: float, tolerance: float
) -> None:
    limits = limits_of(Hints(heading_deg=heading, heading_tolerance_deg=tolerance))
    allowed = bool(limits.allows_rotation(torch.from_numpy(rotation)))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 0.05:  # looks straight up or down
        assert allowed
        return
    yaw = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
    difference = abs((yaw - heading + 180) % 360 - 180)
    if abs(difference - tolerance) > 1e-3:
        assert allowed == (difference <= tolerance)


@given(rotations, points, finite(-180, 180), finite(1, 90), finite(0, 90))
def test_whatever_is_allowed_is_searched(
    rotation: Array, position: Array, heading: float, tolerance: float, tilt: float
) -> None:
    x, y, z = OFFSET.tolist()
    region = (x - 1, y - 1, z - 1), (x + 2, y + 2, z + 2)
    limits = limits_of(Hints((x, y, z), 1.5, region, True, tilt, heading, tolerance))
    turned, placed = torch.from_numpy(rotation)[None], torch.from_numpy(position)[None]
    placed_map: Any = SimpleNamespace(starts=placed, leaf_sizes=torch.tensor([0.5]))
    assert bool(limits.allows_rotation(turned, 0.1)) or not bool(limits.allows_rotation(turned))
    assert bool(limits.searched_starts(placed_map)) or not bool(limits.allows_position(placed))
