"""The search for places where the scan looks as it does at another, in painted boxes with and without a symmetry."""

import math
from dataclasses import replace

import pytest

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.same_views import search_same_views
from tests.core.built_maps import map_of
from tests.core.painted_box import PaintedBox
from tests.core.search.symmetric_box import BOX, POSE, POSITION, ROTATION, TWIN

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()


@pytest.fixture(scope="module")
def symmetric() -> MapIndex:
    return map_of(BOX)


@pytest.fixture(scope="module")
def other() -> MapIndex:
    return map_of(PaintedBox(seed=8))


def search(own: MapIndex, index: MapIndex, limits: PoseLimits | None = None) -> MapCandidates:
    (found,) = search_same_views(own, ROTATION, POSITION, [(index, limits or PoseLimits())], CONFIG)
    return found


def poses(found: MapCandidates, index: MapIndex) -> list[Pose]:
    starts, turns = found.candidates.starts.tolist(), found.candidates.rotations.tolist()
    return [
        Pose(found.rotations[turn].double().numpy(), index.starts[start].double().numpy())
        for start, turn in zip(starts, turns, strict=True)
    ]


def test_the_other_side_of_a_symmetric_room_is_found_and_the_place_itself_is_not(symmetric: MapIndex) -> None:
    found = poses(search(symmetric, symmetric), symmetric)
    assert pose_error(found[0], TWIN).within(0.6, 15.0)
    assert not any(pose_error(pose, POSE).within(0.6, 15.0) for pose in found)
    assert len(found) <= CONFIG.photo_search.same_views


def test_a_room_that_looks_like_no_other_has_none(other: MapIndex) -> None:
    assert len(search(other, other).candidates) == 0


def test_the_same_room_in_another_map_is_found(symmetric: MapIndex, other: MapIndex) -> None:
    again = replace(symmetric)  # registered a second time
    found = poses(search(symmetric, again), again)
    assert any(pose_error(pose, POSE).within(0.6, 15.0) for pose in found)
    assert any(pose_error(pose, TWIN).within(0.6, 15.0) for pose in found)
    assert len(search(symmetric, other).candidates) == 0


def test_only_what_the_limits_allow_is_named(symmetric: MapIndex) -> None:
    heading = math.atan2(POSE.rotation[1, 0], POSE.rotation[0, 0])
    limits = replace(PoseLimits(), heading=heading, heading_tolerance=math.radians(40))
    assert len(search(symmetric, symmetric, limits).candidates) == 0
