"""The search for photos in a painted box: its first look at every pose, its candidates, and how these are moved and added to."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.camera.rig import Session
from panoloc.core.features.fine_views import FineViews
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.geometry.rotations import rotation_angle, uniform_rotations
from panoloc.core.options import Hints
from panoloc.core.search.closer_look import search_around
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.every_pose import scores_of_every_pose
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.patch_scores import patch_scores, patch_scores_of
from panoloc.core.search.photo_search import search_photos
from panoloc.core.search.pixel_scores import pixel_scores
from panoloc.core.search.pose_limits import PoseLimits, pose_limits
from panoloc.core.search.pose_scores import Candidates
from panoloc.core.search.position_sweep import swept
from tests.core.built_maps import BOX, POSE, map_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import MAP_FROM_SESSION, SIDEWAYS, TWO, photo_of, rig_pose, session_of
from tests.core.painted_box import rotation_of
from tests.core.search.found_candidates import CONFIG, described, poses_of, prepared, rank_of

pytestmark = pytest.mark.slow
SEARCH = CONFIG.photo_search
ONE_PHOTO, TWO_PHOTOS = Session.of_photo(photo_of(SIDEWAYS)), session_of(TWO)
POSES = {"one photo": (ONE_PHOTO, POSE), "two photos": (TWO_PHOTOS, rig_pose(TWO_PHOTOS))}


def searched(session: Session, hints: Hints | None = None) -> tuple[MapCandidates, PoseLimits]:
    photos, index = prepared(session), map_of(BOX)
    limits = photos.limits_of_rig(pose_limits(hints, index))
    (found,) = search_photos([photos.described()], [index], [limits], [None], SEARCH, CONFIG.fine_views)
    return found, limits


def assert_among_the_first(pose: Pose, found: MapCandidates) -> None:
    rank = known(rank_of(pose, found, map_of(BOX)))
    assert rank < 10


@pytest.mark.parametrize("session", POSES)
def test_the_right_pose_is_among_the_first_candidates(session: str) -> None:
    photos, pose = POSES[session]
    found, index = searched(photos)[0], map_of(BOX)
    assert_among_the_first(pose, found)
    scores = found.candidates.scores.tolist()
    assert scores == sorted(scores, reverse=True)
    assert 1 < len(scores) <= SEARCH.num_candidates
    assert found.num_starts == index.num_starts
    assert found.num_poses == index.num_starts * SEARCH.num_rotations


def test_with_up_known_fewer_rotations_are_searched_and_only_level_ones() -> None:
    freely, _ = searched(TWO_PHOTOS)
    upright, _ = searched(session_of(TWO, up_known=True))
    assert 0 < len(upright.rotations) < len(freely.rotations) / 10
    most = math.radians(5.0 + SEARCH.limit_margin_deg)
    assert float(upright.rotations[:, 2, 2].min()) >= math.cos(most) - 1e-6
    assert_among_the_first(rig_pose(TWO_PHOTOS), upright)


def test_hints_are_about_the_first_camera_also_when_it_stands_off_the_middle() -> None:
    first, truth = MAP_FROM_SESSION.after(TWO[0]), rig_pose(TWO_PHOTOS)
    yaw = math.degrees(math.atan2(first.rotation[1, 0], first.rotation[0, 0]))
    x, y, z = first.position.tolist()
    hints = Hints(position_m=(x, y, z), radius_m=0.3, heading_deg=yaw, heading_tolerance_deg=10.0, upright=True)
    found, limits = searched(TWO_PHOTOS, hints)
    assert limits.allows_pose(torch.from_numpy(truth.rotation).float(), torch.from_numpy(truth.position).float())
    assert rank_of(truth, found, map_of(BOX)) is not None
    assert 0 < found.num_starts < map_of(BOX).num_starts
    margin = math.radians(SEARCH.limit_margin_deg + 10.0) + 1e-4
    ahead = (found.rotations @ limits.first_rotation)[:, :, 0]  # type: ignore[operator]
    off = torch.atan2(ahead[:, 1], ahead[:, 0]) - math.radians(yaw)
    assert float(torch.atan2(off.sin(), off.cos()).abs().max()) <= margin


def test_the_closer_look_around_a_guess_proposes_the_right_pose_and_nothing_far_from_the_guess() -> None:
    guess, index = Pose(rotation_of(112.0), np.array([2.2, 2.1, 1.5])), map_of(BOX)
    rotation, position = (torch.from_numpy(each).float() for each in (guess.rotation, guess.position))
    found = search_around(described(ONE_PHOTO), index, PoseLimits(), None, rotation, position, CONFIG)
    poses = poses_of(found, index)
    assert any(pose_error(pose, POSE).within(0.6, 12.0) for pose in poses[:3])
    assert 4 < len(poses) <= SEARCH.closer_candidates
    away_m = [np.linalg.norm(pose.position - guess.position) for pose in poses]
    assert max(away_m) <= SEARCH.closer_m + SEARCH.limit_margin_m + 1e-5
    angles = rotation_angle(found.rotations[found.candidates.rotations], rotation)
    assert float(angles.max()) <= math.radians(SEARCH.closer_deg)


# The first look at every pose, against what is worked out pose by pose.

ROTATIONS = uniform_rotations(60)
EVERY = torch.arange(40 * len(ROTATIONS))
EVERY_POSE = EVERY // len(ROTATIONS), EVERY % len(ROTATIONS)


@cache
def views() -> FineViews:
    """Return views of which some show nothing in places, as those of an open scan."""
    some = map_of(BOX).fine_views.take(torch.arange(40))
    some.seen[::3, 10:20] = False
    return some


@pytest.fixture(params=POSES)
def photos(request: pytest.FixtureRequest) -> DescribedPhotos:
    return described(POSES[request.param][0], 512)


def test_all_at_once_is_what_each_would_have(photos: DescribedPhotos) -> None:
    """Of labels, which are not equalized pose by pose, the two are the same number."""
    found = scores_of_every_pose(photos.pixels, views(), ROTATIONS, True, SEARCH)
    expected = pixel_scores(photos.pixels, views(), ROTATIONS, *EVERY_POSE, True, SEARCH)
    assert found.shape == (40, len(ROTATIONS))
    torch.testing.assert_close(found.flatten(), expected, atol=2e-4, rtol=0)


def test_one_table_for_the_map_ranks_nearly_as_one_for_each_pose(photos: DescribedPhotos) -> None:
    found = scores_of_every_pose(photos.pixels, views(), ROTATIONS, False, SEARCH).flatten()
    expected = pixel_scores(photos.pixels, views(), ROTATIONS, *EVERY_POSE, False, SEARCH)
    assert float(torch.corrcoef(torch.stack((found, expected)))[0, 1]) > 0.9


def test_patches_of_some_poses_are_those_of_all(photos: DescribedPhotos) -> None:
    grid = PatchGrid(CONFIG.fine_views.patch_rows, CONFIG.fine_views.patch_columns)
    every = patch_scores(photos, views().descriptors(), ROTATIONS, grid)
    start, rotation = torch.tensor([0, 3, 39, 3]), torch.tensor([5, 59, 0, 6])
    some = patch_scores_of(photos, views(), ROTATIONS, start, rotation, grid)
    torch.testing.assert_close(some, every[start, rotation], atol=1e-5, rtol=1e-4)


# Candidates moved to where they fit best around their starts.


def near_starts(pose: Pose, count: int) -> tuple[MapCandidates, Tensor]:
    """Return the starts nearest to a pose, turned as it is, as a search would find them; and its place."""
    place = torch.from_numpy(pose.position).float()
    starts = torch.cdist(map_of(BOX).starts, place[None])[:, 0].argsort()[:count]
    rotations = torch.from_numpy(pose.rotation).float().expand(count, 3, 3)
    return MapCandidates(Candidates(starts, torch.arange(count), torch.zeros(count)), rotations, count, count), place


@pytest.mark.parametrize("session", POSES)
def test_a_candidate_moves_to_where_the_photo_was_taken(session: str) -> None:
    asked, pose = POSES[session]
    found, place = near_starts(pose, 4)
    search = replace(SEARCH, swept_distinct=replace(SEARCH.swept_distinct, distance_m=0.01))
    moved = swept(described(asked, 512), map_of(BOX), found, search).candidates
    before = (map_of(BOX).starts[found.candidates.starts] - place).norm(dim=-1).min()
    assert float((known(moved.places)[0] - place).norm()) < min(0.15, float(before))
    assert (moved.scores.diff() <= 1e-6).all()


def test_what_is_near_a_better_one_is_left_out() -> None:
    found, _ = near_starts(POSE, 12)
    photos = described(ONE_PHOTO, 512)
    moved = swept(photos, map_of(BOX), found, replace(SEARCH, swept_closer=0, fewest_swept_closer=0))
    places = known(moved.candidates.places)
    apart = torch.cdist(places, places) + 10 * torch.eye(len(places))
    assert float(apart.min()) >= SEARCH.swept_distinct.distance_m
    few = swept(photos, map_of(BOX), found, replace(SEARCH, num_candidates=2))
    assert len(few.candidates) == 2


def test_nothing_found_is_nothing_moved() -> None:
    none, _ = near_starts(POSE, 0)
    assert swept(described(ONE_PHOTO), map_of(BOX), none, SEARCH) is none
