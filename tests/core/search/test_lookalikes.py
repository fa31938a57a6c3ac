"""The searches for places that look like one that was found, by the photo and by the scan alone, in boxes with a symmetry and without."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch

from panoloc.core.camera.rig import Session
from panoloc.core.geometry.pose import pose_error
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.lookalikes import described_as_scanned, search_lookalikes
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.same_views import search_same_views
from tests.core.built_maps import OTHER_BOX, POSE, SYMMETRIC, TWIN, map_of, tensors_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import UPRIGHT, photo_of
from tests.core.painted_box import PaintedBox
from tests.core.search.found_candidates import CONFIG, described, poses_of, rank_of

pytestmark = pytest.mark.slow
ROTATION, POSITION = (each[0] for each in tensors_of(POSE))


def described_in(box: PaintedBox) -> DescribedPhotos:
    return described(Session.of_photo(photo_of(UPRIGHT, POSE, box)))


@cache
def as_scanned() -> DescribedPhotos:
    """Return what the photo of another room would show at the pose in the symmetric one."""
    return described_as_scanned(described_in(OTHER_BOX), map_of(SYMMETRIC), ROTATION, POSITION, CONFIG)


def test_what_is_described_is_the_scan_and_not_the_photo() -> None:
    stranger = described_in(OTHER_BOX)
    scanned, own, other = as_scanned().pixels, described_in(SYMMETRIC).pixels, stranger.pixels
    both = own.solid > 0
    assert torch.equal(scanned.directions, other.directions)
    assert torch.equal(as_scanned().patches, stranger.patches)
    assert (scanned.colors - own.colors)[both].abs().mean() < 0.06 < (other.colors - own.colors)[both].abs().mean()


def test_both_sides_of_a_symmetric_room_are_found_first_and_gravity_is_kept() -> None:
    found = search_lookalikes(as_scanned(), map_of(SYMMETRIC), PoseLimits(), ROTATION, CONFIG)
    for pose in (POSE, TWIN):
        rank = known(rank_of(pose, found, map_of(SYMMETRIC)))
        assert rank < 4
    assert len(found.rotations) == CONFIG.photo_search.lookalike_turns
    torch.testing.assert_close(found.rotations[:, 2], ROTATION[2].expand(len(found.rotations), 3))


# By the scan alone.


def same_views(own: MapIndex, index: MapIndex, limits: PoseLimits | None = None) -> MapCandidates:
    (found,) = search_same_views(own, ROTATION, POSITION, [(index, limits or PoseLimits())], CONFIG)
    return found


def test_the_other_side_of_a_symmetric_room_is_found_and_the_place_itself_is_not() -> None:
    found = same_views(map_of(SYMMETRIC), map_of(SYMMETRIC))
    assert pose_error(poses_of(found, map_of(SYMMETRIC))[0], TWIN).within(0.6, 15.0)
    assert rank_of(POSE, found, map_of(SYMMETRIC)) is None
    assert len(found.candidates) <= CONFIG.photo_search.same_views


def test_a_room_that_looks_like_no_other_has_none() -> None:
    assert len(same_views(map_of(OTHER_BOX), map_of(OTHER_BOX)).candidates) == 0
    assert len(same_views(map_of(SYMMETRIC), map_of(OTHER_BOX)).candidates) == 0


def test_the_same_room_in_another_map_is_found() -> None:
    again = replace(map_of(SYMMETRIC))  # registered a second time
    found = same_views(map_of(SYMMETRIC), again)
    assert rank_of(POSE, found, again) is not None
    assert rank_of(TWIN, found, again) is not None


def test_only_what_the_limits_allow_is_named() -> None:
    heading = math.atan2(POSE.rotation[1, 0], POSE.rotation[0, 0])
    limits = replace(PoseLimits(), heading=heading, heading_tolerance=math.radians(40))
    assert len(same_views(map_of(SYMMETRIC), map_of(SYMMETRIC), limits).candidates) == 0
