"""Hints as limits on poses."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.errors import OptionsError
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.options import Hints, PosePrior
from panoloc.core.search.pose_limits import PoseLimits, pose_limits, within_reach


def starts_at(places: Tensor, size_m: float) -> Any:
    """Return a map of starts (T, 3) in leaves of one size."""
    return SimpleNamespace(starts=places, leaf_sizes=torch.full((len(places),), size_m))


MAP: Any = SimpleNamespace(origin_offset=np.array([1_000_000.25, -2_000_000.5, 100.0]))


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> torch.Tensor:
    """Return the rotation about one of the axes, degrees."""
    return rotation_from_vector(torch.deg2rad(torch.tensor([x, y, z])))


def test_without_hints_nothing_is_limited() -> None:
    for hints in (None, Hints()):
        limits = pose_limits(hints, MAP)
        assert bool(limits.allows_position(torch.tensor([1e6, -1e6, 1e6])))
        assert bool(limits.allows_rotation(turned(x=180.0)))
        assert (limits.center, limits.lower, limits.upper, limits.max_tilt, limits.heading) == (None,) * 5


@pytest.mark.parametrize(
    ("hints", "max_tilt_deg"),
    [
        (Hints(upright=True), 45.0),
        (Hints(upright=True, max_tilt_deg=3.0), 3.0),
        (Hints(max_tilt_deg=0.0), 0.0),
        (Hints(upright=True, max_tilt_deg=0.0), 0.0),
        (Hints(), None),
    ],
)
def test_upright_means_45_degrees_unless_the_caller_says_how_much(hints: Hints, max_tilt_deg: float | None) -> None:
    found = pose_limits(hints, MAP).max_tilt
    assert found == (None if max_tilt_deg is None else pytest.approx(math.radians(max_tilt_deg)))


@pytest.mark.parametrize(("std_m", "radius_m"), [(0.1, 1.5), (2.0, 6.0)])
def test_what_is_refined_away_from_the_only_prior_is_no_answer(std_m: float, radius_m: float) -> None:
    # The frame's y axis points up.
    prior = PosePrior((1_000_000.25, 100.0, 2_000_000.5), (0.0, 0.0, 0.0, 1.0), "webxr", std_m)
    assert pose_limits(Hints(prior=prior), MAP).center is None
    limits = pose_limits(Hints(prior=replace(prior, is_only=True)), MAP)
    places = torch.tensor([[0.0, radius_m - 0.01, 0.0], [0.0, 0.0, radius_m + 0.01]])
    assert limits.allows_position(places).tolist() == [True, False]


@pytest.mark.parametrize("yaw", [0.0, 37.3, 291.7])
def test_a_level_camera_is_allowed_where_none_may_tilt(yaw: float) -> None:
    limits = pose_limits(Hints(max_tilt_deg=0.0), MAP)
    turned_back = limits.nearest_rotations(turned(x=0.3, y=-0.2)[None] @ turned(z=yaw))
    assert limits.allows_rotation(turned_back).tolist() == [True]
    assert not bool(limits.allows_rotation(turned(x=0.1)))
    aboard = limits.of_rig(turned(z=20.0, x=5.0), torch.zeros(3), None)
    assert aboard.allows_rotation(aboard.nearest_rotations(turned_back)).tolist() == [True]


def test_a_position_is_taken_within_five_metres_and_a_heading_within_45_degrees() -> None:
    limits = pose_limits(Hints(position_m=(1_000_000.25, -2_000_000.5, 100.0), heading_deg=0.0), MAP)
    assert limits.radius_m == 5.0
    assert limits.heading == 0.0
    places = torch.tensor([[0.0, 4.9, 0.0], [0.0, 0.0, -5.1]])
    assert limits.allows_position(places).tolist() == [True, False]
    headings = torch.stack([turned(z=44.0), turned(z=-44.0), turned(z=46.0), turned(z=-46.0)])
    assert limits.allows_rotation(headings).tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("hints", "said"),
    [
        (Hints(position_m=(0, math.nan, 0)), "hints: expected finite numbers"),
        (Hints(region=((0, 0, 0), (1, math.inf, 1))), "hints: expected finite numbers"),
        (Hints(heading_deg=math.inf), "hints: expected finite numbers"),
        (Hints(radius_m=1.0), r"hints\.radius_m: expected together with"),
        (Hints(position_m=(0, 0, 0), radius_m=0.0), r"hints\.radius_m: expected a positive number"),
        (Hints(position_m=(0, 0, 0), radius_m=math.inf), r"hints\.radius_m: expected a positive number"),
        (Hints(max_tilt_deg=-0.1), r"hints\.max_tilt_deg: expected 0 to 180"),
        (Hints(max_tilt_deg=180.1), r"hints\.max_tilt_deg: expected 0 to 180"),
        (Hints(heading_deg=1.0, heading_tolerance_deg=0.0), r"heading_tolerance_deg: expected more than 0"),
        (Hints(heading_tolerance_deg=180.1), r"heading_tolerance_deg: expected more than 0"),
        (Hints(region=((0, 0, 0), (1, 0, 1))), r"hints\.region: expected min below max"),
        (Hints(prior=PosePrior((0, 0, 0), (0, 0, 0, 0))), r"hints\.prior: expected .* a unit quaternion"),
        (Hints(prior=PosePrior((0, 0, 0), (0, 0, 0, 2))), r"hints\.prior: expected"),
        (Hints(prior=PosePrior((0, math.nan, 0), (0, 0, 0, 1))), r"hints\.prior: expected"),
        (Hints(prior=PosePrior((0, 0, 0), (0, 0, 0, 1), "ros", 0.0)), r"hints\.prior: expected"),
        (Hints(prior=PosePrior((0, 0, 0), (0, 0, 0, 1), "ros", 0.3, -1.0)), r"hints\.prior: expected"),
    ],
)
def test_hints_that_make_no_sense_are_refused(hints: Hints, said: str) -> None:
    with pytest.raises(OptionsError, match=said):
        pose_limits(hints, MAP)


def test_a_region_ends_at_its_faces_and_a_radius_at_its_sphere() -> None:
    limits = PoseLimits(center=torch.zeros(3), radius_m=2.0, lower=-torch.ones(3), upper=torch.tensor([1.0, 1.0, 3.0]))
    places = torch.tensor([[1.0, 1.0, 1.0], [1.01, 0, 0], [0, -1.01, 0], [0, 0, 2.0], [0, 0, 2.01], [-1.0, -1.0, -1.0]])
    assert limits.allows_position(places).tolist() == [True, False, False, True, False, True]
    widened = torch.tensor([[1.2, 0, 0], [1.3, 0, 0], [0, -1.2, 0], [0, 0, 2.2], [0, 0, 2.3]])
    assert limits.allows_position(widened, 0.25).tolist() == [True, False, True, True, False]


STARTS: Any = SimpleNamespace(
    starts=torch.tensor([[0.0, 0.0, 1.0], [3.0, 2.0, 1.5]]),
    leaf_sizes=torch.tensor([0.4, 1.0]),
    origin_offset=np.zeros(3),
)


def test_without_a_hint_of_the_place_poses_stay_in_reach_of_the_free_space() -> None:
    limits = within_reach(PoseLimits(max_tilt=0.1), STARTS)
    assert limits.max_tilt == 0.1
    inside = torch.tensor([[-0.69, -0.69, 0.31], [3.99, 2.99, 2.49], [1.5, 1.0, 1.0]])
    assert limits.allows_position(inside).all()
    outside = torch.tensor([[-0.71, 0, 1], [0, -0.71, 1], [0, 0, 0.29], [4.01, 2, 1], [3, 3.01, 1], [3, 2, 2.51]])
    assert not limits.allows_position(outside).any()
    assert limits.searched_starts(STARTS).all()


@pytest.mark.parametrize("hints", [Hints(position_m=(90.0, 0.0, 0.0)), Hints(region=((50.0, 0, 0), (60.0, 1, 1)))])
def test_a_hint_of_the_place_counts_however_far_beyond_the_scan(hints: Hints) -> None:
    limits = pose_limits(hints, STARTS)
    assert within_reach(limits, STARTS) == limits


def test_the_search_reaches_beyond_the_hints_by_its_margins() -> None:
    limits = PoseLimits(center=torch.zeros(3), radius_m=1.0, max_tilt=math.radians(10))
    assert limits.searched_starts(starts_at(torch.tensor([[1.19, 0, 0], [1.21, 0, 0]]), 0.2)).tolist() == [True, False]
    assert limits.allows_rotation(torch.stack((turned(x=16.5), turned(x=17.5))), math.radians(7.0)).tolist() == [
        True,
        False,
    ]


# Of a rig, whose first camera the hints are about.


def test_hints_of_a_rig_are_about_its_first_camera() -> None:
    first_rotation, first_center = turned(z=90.0), torch.tensor([0.5, 0.0, 0.0])
    level = PoseLimits(center=torch.tensor([2.0, 0.0, 0.0]), radius_m=0.2, heading=0.0, heading_tolerance=0.1)
    limits = level.of_rig(first_rotation, first_center, None)
    # The first camera heads where the rig does, and a quarter turn further; it stands 0.5 m from the rig's middle.
    assert limits.allows_pose(turned(z=-90.0), torch.tensor([2.0, 0.5, 0.0]))
    assert not limits.allows_pose(turned(z=-90.0), torch.tensor([2.0, 0.0, 0.0]))
    assert not limits.allows_pose(turned(), torch.tensor([1.5, 0.0, 0.0]))
    assert bool(limits.allows_rotation(turned(z=-90.0)))
    assert not bool(limits.allows_rotation(turned()))
    # Of a camera alone they are about itself.
    assert level.allows_pose(turned(), torch.tensor([2.0, 0.0, 0.0]))
    assert not level.allows_pose(turned(), torch.tensor([1.5, 0.0, 0.0]))
    assert not level.allows_pose(turned(z=-90.0), torch.tensor([2.0, 0.0, 0.0]))


def test_a_rig_whose_up_axis_is_known_stays_upright_however_its_first_camera_is_held() -> None:
    limits = PoseLimits().of_rig(turned(x=90.0), torch.zeros(3), math.radians(5))
    tilted = torch.stack([turned(z=77.0), turned(x=4.0), turned(x=6.0), turned(y=-6.0), turned(x=-90.0)])
    assert limits.allows_rotation(tilted).tolist() == [True, True, False, False, False]
    assert limits.allows_rotation(tilted, math.radians(3.0)).tolist() == [True, True, True, True, False]


def test_starts_are_searched_as_far_as_the_first_camera_may_be_from_the_middle() -> None:
    limits = PoseLimits(center=torch.zeros(3), radius_m=1.0).of_rig(torch.eye(3), torch.tensor([0.0, 0.3, 0.4]), None)
    places = torch.tensor([[1.69, 0, 0], [0, 0, -1.69], [1.71, 0, 0]])
    assert limits.searched_starts(starts_at(places, 0.2)).tolist() == [True, True, False]


def test_what_tilts_too_much_is_turned_back_by_no_more_than_it_takes() -> None:
    most = math.radians(5.0)
    limits = PoseLimits(max_rig_tilt=most)
    tilted = torch.stack([turned(x=20.0) @ turned(z=70.0), turned(y=-12.0) @ turned(z=170.0), turned(x=3.0)])
    back = limits.nearest_rotations(tilted)
    assert limits.allows_rotation(back).tolist() == [True, True, True]
    assert torch.allclose(back[2], tilted[2], atol=1e-6)
    moved = torch.rad2deg(torch.acos((((back * tilted).sum((1, 2)) - 1) / 2).clamp(-1, 1)))
    assert moved[:2].tolist() == pytest.approx([15.0, 7.0], abs=0.05)


def test_a_camera_that_hangs_in_a_rig_is_turned_back_by_its_own_up_axis() -> None:
    mounted = turned(x=30.0)  # in the rig
    limits = PoseLimits(max_tilt=math.radians(10.0)).of_rig(mounted, torch.zeros(3), None)
    rig = torch.eye(3)[None]
    assert not bool(limits.allows_rotation(rig))
    back = limits.nearest_rotations(rig)
    assert bool(limits.allows_rotation(back))
    up = (back[0] @ mounted)[:, 2]
    assert math.degrees(math.acos(float(up[2]))) == pytest.approx(10.0, abs=0.02)
