"""Hints as limits on poses."""

import math

import torch

from core.config import SearchConfig
from core.search.pose_limits import PoseLimits


def test_limits_widen_for_the_search_and_not_for_the_answer() -> None:
    limits = PoseLimits(center=torch.zeros(3), radius_m=1.0, max_tilt=math.radians(10))
    assert bool(limits.searched_starts(torch.tensor([[1.3, 0.0, 0.0]]), SearchConfig()))
    assert not bool(limits.allows_position(torch.tensor([1.3, 0.0, 0.0])))
    tilted = torch.tensor(
        [
            [1.0, 0, 0],
            [0, math.cos(math.radians(15)), -math.sin(math.radians(15))],
            [0, math.sin(math.radians(15)), math.cos(math.radians(15))],
        ]
    )
    assert bool(limits.searched_rotations(tilted[None], SearchConfig()))
    assert not bool(limits.allows_rotation(tilted))


def test_a_heading_near_half_a_turn_wraps() -> None:
    limits = PoseLimits(heading=math.radians(179), heading_tolerance=math.radians(5))
    turned = torch.tensor([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])  # heading 180
    across = torch.tensor(
        [
            [math.cos(math.radians(-178)), -math.sin(math.radians(-178)), 0],
            [math.sin(math.radians(-178)), math.cos(math.radians(-178)), 0],
            [0, 0, 1],
        ]
    )
    assert limits.allows_rotation(torch.stack((turned, across, torch.eye(3)))).tolist() == [True, True, False]
