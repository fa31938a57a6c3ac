"""Candidates: which of many poses are kept, and how they move to where they fit best around their starts."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from panoloc.core.config import DISTANCES
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.search.position_sweep import Candidates, swept
from tests.core.built_maps import BOX, POSE, map_of
from tests.core.search.found_candidates import CONFIG, RIGS, query

SEARCH = CONFIG.search


def candidates(places_m: list[float], yaws_deg: list[float], scores: list[float]) -> Candidates:
    """Return candidates along an axis, turned about the vertical."""
    count = len(places_m)
    turns = torch.zeros((count, 3))
    turns[:, 2] = torch.deg2rad(torch.tensor(yaws_deg))
    positions = torch.tensor(places_m)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    return Candidates(
        torch.arange(count), rotation_from_vector(turns), positions, torch.tensor(scores), torch.zeros(count)
    )


def test_of_poses_that_hardly_differ_only_the_best_is_kept() -> None:
    # Half a metre and 15 degrees apart poses are at other places.
    places, yaws = [0.0, 0.4, 0.6, 0.0, 0.0], [0.0, 0.0, 0.0, 14.0, 16.0]
    found = candidates(places, yaws, [0.5, 0.9, 0.3, 0.4, 0.2]).ranked(9)
    assert found.starts.tolist() == [1, 4]  # the place itself is near the second; the third is as well
    found = candidates(places, yaws, [0.9, 0.5, 0.3, 0.4, 0.2]).ranked(9)
    assert found.starts.tolist() == [0, 2, 4]  # another place seen the same way, and the same seen another way
    torch.testing.assert_close(found.scores, torch.tensor([0.9, 0.3, 0.2]))


def test_no_more_are_kept_than_asked_for_nor_any_beyond_the_pool() -> None:
    some = candidates([2.0 * k for k in range(6)], [0.0] * 6, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert some.ranked(2, 6).starts.tolist() == [5, 4]
    assert some.ranked(6, 3).starts.tolist() == [5, 4, 3]


# Candidates moved to where they fit best around their starts.


def near_starts(pose: Pose, count: int) -> tuple[Candidates, Tensor]:
    """Return the starts nearest to a pose, turned as it is, as a search would find them; and its place."""
    place = torch.from_numpy(pose.position).float()
    starts = torch.cdist(map_of(BOX).starts, place[None])[:, 0].argsort()[:count]
    rotations = torch.from_numpy(pose.rotation).float().expand(count, 3, 3)
    zero = torch.zeros(count)
    return Candidates(starts, rotations, map_of(BOX).starts[starts], zero, zero), place


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one photo", "two photos"])
def test_a_candidate_moves_to_where_the_photo_was_taken(name: str) -> None:
    found, place = near_starts(RIGS[name][1], 4)
    moved = swept(query(name).rig.described, map_of(BOX), found, 4, SEARCH)
    before = (map_of(BOX).starts[found.starts] - place).norm(dim=-1).min()
    assert float((moved.positions[0] - place).norm()) < min(0.15, float(before))
    assert (moved.scores.diff() <= 1e-6).all()


@pytest.mark.slow
def test_what_is_near_a_better_one_is_left_out() -> None:
    found, _ = near_starts(POSE, 7)
    photos, index = query("one photo").rig.described, map_of(BOX)
    # Pixels for all of them, which are those of one on finer pictures.
    pixels = len(found) * SEARCH.sweep_places**3 * len(photos.pixels)
    moved = swept(photos, index, found, 7, replace(SEARCH, rescored_pixels=pixels))
    apart = torch.cdist(moved.positions, moved.positions) + 10 * torch.eye(len(moved))
    assert 1 < len(moved) < 7
    assert float(apart[1:, 1:].min()) >= DISTANCES.place.distance_m  # the first has moved once more, on finer pictures
    assert len(swept(photos, index, found, 2, SEARCH)) == 2


@pytest.mark.slow
def test_nothing_found_is_nothing_moved() -> None:
    none, _ = near_starts(POSE, 0)
    assert swept(query("one photo").rig.described, map_of(BOX), none, 4, SEARCH) is none
