"""The search of a painted box: which poses it scores, and which of them it proposes."""

import math
from dataclasses import replace

import pytest
import torch

from panoloc.core.geometry.rotations import rotation_from_vector, rotation_spacing, uniform_rotations
from panoloc.core.kernels.library import num_threads, use_threads
from panoloc.core.options import Hints
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.search.map_search import search_maps
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.position_sweep import Candidates
from tests.core.built_maps import BOX, OTHER_BOX, map_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import MAP_FROM_SESSION, TWO, rig_pose, session_of
from tests.core.search.found_candidates import CONFIG, RIGS, TWO_PHOTOS, poses_of, query, query_of, rank_of

pytestmark = pytest.mark.slow
SEARCH = CONFIG.search
NARROW_MARGIN = rotation_spacing(SEARCH.rotations) / 2  # rad, and less of the denser set


def searched(query: MapQuery, limits: PoseLimits | None = None) -> tuple[Candidates, int, int]:
    """Return what is found in one map, how many starts there were, and how many poses were scored."""
    (found,), num_starts, num_poses = search_maps([query.search], [limits or query.limits], [None], SEARCH)
    return found, num_starts, num_poses


@pytest.mark.parametrize("name", RIGS)
def test_maps_that_are_searched_at_once_propose_what_they_do_one_after_the_other(name: str) -> None:
    with torch.inference_mode():
        both = prepare_queries(RIGS[name][0], [map_of(BOX), map_of(OTHER_BOX)], None, CONFIG)
        given = [one.search for one in both], [one.limits for one in both], [None, None], SEARCH
        before, of_tensors, found = num_threads(), torch.get_num_threads(), []
        try:
            for threads in (1, 2):
                use_threads(threads)
                found.append(search_maps(*given))
        finally:
            use_threads(before)
            torch.set_num_threads(of_tensors)
    assert found[0][1:] == found[1][1:]
    for alone, at_once in zip(found[0][0], found[1][0], strict=True):
        assert len(alone) > 1
        assert torch.equal(alone.positions, at_once.positions)
        assert torch.equal(alone.scores, at_once.scores)


@pytest.mark.parametrize("name", RIGS)
def test_the_right_pose_is_among_the_first_candidates(name: str) -> None:
    (found, num_starts, _), index = searched(query(name)), map_of(BOX)
    assert known(rank_of(RIGS[name][1], poses_of(found, index))) < 10
    scores = found.scores.tolist()
    assert scores == sorted(scores, reverse=True)
    assert 1 < len(scores) <= SEARCH.num_candidates
    assert num_starts == index.num_starts


def test_of_a_photo_every_start_is_scored_with_every_rotation_and_of_a_panorama_a_share_of_the_starts() -> None:
    starts = map_of(BOX).num_starts
    assert searched(query("one photo"))[2] == starts * SEARCH.rotations
    kept = math.ceil(SEARCH.kept_share * starts)
    assert kept < starts
    assert searched(query("panorama"))[2] == kept * (SEARCH.rotations // 4)


@pytest.mark.parametrize("share", [0.5, 0.1, 0.001])
def test_the_first_pass_keeps_the_starts_that_it_likes_best_over_all_maps(share: float) -> None:
    config = replace(SEARCH, kept_share=share)
    queries = prepare_queries(RIGS["panorama"][0], [map_of(BOX), map_of(OTHER_BOX)], None, CONFIG)
    searches, limits = [each.search for each in queries], [each.limits for each in queries]
    first = [search.first_scores(limit) for search, limit in zip(searches, limits, strict=True)]
    count = math.ceil(share * sum(map(len, first)))
    least = float(torch.cat(first).sort(descending=True).values[count - 1])
    found, num_starts, num_poses = search_maps(searches, limits, [None, None], config)
    assert (num_starts, num_poses) == (sum(map(len, first)), count * (SEARCH.rotations // 4))
    for part, scores in zip(found, first, strict=True):
        assert (scores[part.starts] >= least).all()


def test_starts_that_the_first_pass_cannot_judge_go_on() -> None:
    # Of the few rotations of the first pass the hints leave none, of the many some.
    level = PoseLimits(max_tilt=0.0, heading=0.0, heading_tolerance=0.0)
    config = replace(CONFIG, search=replace(SEARCH, kept_share=0.01))
    search = query_of(RIGS["panorama"][0], config=config).search
    assert search.first_scores(level).isinf().all()
    *_, num_poses = search_maps([search], [level], [None], config.search)
    count = SEARCH.rotations // 4
    allowed = level.allows_rotation(uniform_rotations(count), rotation_spacing(count) / 2)
    assert num_poses == map_of(BOX).num_starts * int(allowed.sum()) > 0


def test_with_up_known_fewer_rotations_are_searched_and_only_level_ones() -> None:
    *_, of_all = searched(query("two photos"))
    upright, _, num_poses = searched(query_of(session_of(TWO, up_known=True)))
    assert 0 < num_poses < of_all / 10
    most = math.radians(5.0) + NARROW_MARGIN
    assert float(upright.rotations[:, 2, 2].min()) >= math.cos(most) - 1e-6
    assert known(rank_of(rig_pose(TWO_PHOTOS), poses_of(upright, map_of(BOX)))) < 10


def test_hints_are_about_the_first_camera_also_when_it_stands_off_the_middle() -> None:
    first, truth = MAP_FROM_SESSION.after(TWO[0]), rig_pose(TWO_PHOTOS)
    yaw = math.degrees(math.atan2(first.rotation[1, 0], first.rotation[0, 0]))
    x, y, z = first.position.tolist()
    hints = Hints(position_m=(x, y, z), radius_m=0.3, heading_deg=yaw, heading_tolerance_deg=10.0, upright=True)
    query = query_of(TWO_PHOTOS, hints)
    (found, num_starts, _), limits = searched(query), query.limits
    assert limits.allows_pose(torch.from_numpy(truth.rotation).float(), torch.from_numpy(truth.position).float())
    assert rank_of(truth, poses_of(found, map_of(BOX))) is not None
    assert 0 < num_starts < map_of(BOX).num_starts
    margin = math.radians(10.0) + NARROW_MARGIN + 1e-4
    ahead = (found.rotations @ known(limits.first_rotation))[:, :, 0]
    off = torch.atan2(ahead[:, 1], ahead[:, 0]) - math.radians(yaw)
    assert float(torch.atan2(off.sin(), off.cos()).abs().max()) <= margin


@pytest.mark.parametrize("name", ["panorama", "one photo"])
def test_hints_that_leave_nothing_are_answered_with_nothing(name: str) -> None:
    far = PoseLimits(center=torch.tensor([99.0, 0.0, 0.0]), radius_m=1.0)
    # A rig that stands upright, and its first camera as well, which lies on its side in it.
    on_its_side = rotation_from_vector(torch.tensor([math.pi / 2, 0.0, 0.0]))
    level = PoseLimits(max_tilt=0.1).of_rig(on_its_side, torch.zeros(3), 0.1)
    for limits, starts in ((far, 0), (level, map_of(BOX).num_starts)):
        found, *counts = searched(query(name), limits)
        assert (len(found), *counts) == (0, starts, 0)
