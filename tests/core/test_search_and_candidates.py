"""Starts, candidates, limits and the search, on small inputs with known answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from core.config import SearchConfig, StartsConfig
from core.describe.patch_descriptors import ViewDescriptors
from core.errors import OptionsError
from core.geometry.pose import Pose
from core.geometry.rotations import rotation_angle, uniform_rotations
from core.index.map_index import IndexOptions, MapIndex
from core.index.starts import grid_starts, octree_starts
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaPyramid
from core.search.map_search import describe_panorama, make_search_rotations, search_maps
from core.search.pose_limits import PoseLimits
from core.search.pose_scores import select_candidates
from tests.core.painted_box import PaintedBox


@pytest.fixture(scope="module")
def room_points() -> np.ndarray:
    return PaintedBox(size_m=(6.0, 5.0, 2.6)).scan(30_000).positions


def test_octree_starts_lie_in_free_space_inside_the_room(room_points: np.ndarray) -> None:
    starts = octree_starts(room_points, StartsConfig())
    assert (starts.positions > 0).all()
    assert (starts.positions < (6.0, 5.0, 2.6)).all()
    gaps = np.minimum(starts.positions, np.array([6.0, 5.0, 2.6]) - starts.positions).min(axis=1)
    assert gaps.min() > 0.1


def test_octree_starts_are_dense_enough_for_the_basin_of_convergence(room_points: np.ndarray) -> None:
    starts = octree_starts(room_points, StartsConfig()).positions
    probes = np.random.default_rng(0).uniform((0.5, 0.5, 0.5), (5.5, 4.5, 2.1), (500, 3))
    nearest = np.linalg.norm(probes[:, None] - starts[None], axis=2).min(axis=1)
    assert nearest.max() < 0.5


def test_starts_keep_away_from_furniture(room_points: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    cupboard = rng.uniform((2.0, 2.0, 0.0), (3.0, 3.0, 2.0), (20_000, 3)).astype(np.float32)
    starts = octree_starts(np.concatenate((room_points, cupboard)), StartsConfig()).positions
    inside = ((starts > (2.0, 2.0, 0.0)) & (starts < (3.0, 3.0, 2.0))).all(axis=1)
    assert not inside.any()


def test_the_number_of_starts_follows_the_volume_up_to_the_limit() -> None:
    counts = []
    for side in (3.0, 6.0, 12.0, 24.0):
        points = PaintedBox(size_m=(side, side, 2.6)).scan(20_000).positions
        counts.append(len(octree_starts(points, StartsConfig(max_starts=400))))
    assert counts[0] < counts[1]
    assert counts[1] <= 400
    assert 200 <= counts[2] <= 400
    assert 200 <= counts[3] <= 400


def test_starts_stay_inside_a_region(room_points: np.ndarray) -> None:
    region = np.array([1.0, 1.0, 1.0]), np.array([3.0, 2.5, 1.8])
    for find in (octree_starts, grid_starts):
        positions = find(room_points, StartsConfig(), region).positions
        assert len(positions) > 3
        assert (positions >= region[0]).all()
        assert (positions <= region[1]).all()


def test_a_region_outside_of_the_scan_is_refused(room_points: np.ndarray) -> None:
    with pytest.raises(OptionsError, match="region"):
        octree_starts(room_points, StartsConfig(), (np.array([50.0, 0, 0]), np.array([60.0, 5, 2])))


def test_grid_starts_are_a_regular_grid_of_the_spacing() -> None:
    points = np.random.default_rng(0).uniform((0, 0, 0), (10, 8, 4), (20_000, 3)).astype(np.float32)
    starts = grid_starts(points, StartsConfig(spacing_m=1.0)).positions
    assert len(starts) == 10 * 8 * 4
    for axis in range(3):
        steps = np.diff(np.unique(starts[:, axis].round(6)))
        np.testing.assert_allclose(steps, 1.0, atol=0.02)


def test_strays_far_outside_do_not_spend_the_starts(room_points: np.ndarray) -> None:
    strays = np.random.default_rng(2).uniform(-300, 300, (20, 3)).astype(np.float32)
    starts = octree_starts(np.concatenate((room_points, strays)), StartsConfig()).positions
    inside = ((starts > -0.5) & (starts < (6.5, 5.5, 3.1))).all(axis=1)
    assert inside.mean() > 0.9


@pytest.mark.parametrize(
    "options",
    [{"starts_method": "random"}, {"spacing_m": 0.01}, {"color_kind": "grey"}, {"region": ((0, 0, 0), (1, 0, 1))}],
)
def test_index_options_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(OptionsError):
        IndexOptions(**options)  # type: ignore[arg-type]


# Candidates.


def test_candidates_come_best_first_and_differ_from_each_other() -> None:
    rng = np.random.default_rng(3)
    positions = torch.from_numpy(rng.uniform(0, 4, (30, 3))).float()
    rotations = uniform_rotations(200)
    scores = torch.from_numpy(rng.normal(size=(30, 200))).float()
    chosen = select_candidates(scores, positions, rotations, 12, 25.0, 0.8)
    assert len(chosen) == 12
    assert chosen.scores.tolist() == sorted(chosen.scores.tolist(), reverse=True)
    assert float(chosen.scores[0]) == float(scores.max())
    for i in range(12):
        for j in range(i):
            near = float((positions[chosen.starts[i]] - positions[chosen.starts[j]]).norm()) < 0.8
            angle = float(rotation_angle(rotations[chosen.rotations[i]], rotations[chosen.rotations[j]]))
            assert not (near and angle < math.radians(25.0))


def test_excluded_poses_are_never_candidates() -> None:
    scores = torch.full((3, 5), -math.inf)
    scores[1, 2] = 0.5
    chosen = select_candidates(scores, torch.zeros((3, 3)), uniform_rotations(5), 4, 25.0, 0.8)
    assert chosen.starts.tolist() == [1]
    assert chosen.rotations.tolist() == [2]


def test_the_search_ranks_a_pose_near_the_true_one_among_the_first(
    box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    config = SearchConfig()
    rotations = make_search_rotations(config, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, config)
    (result,) = search_maps([described], [box_index], rotations, [PoseLimits()], config)
    found, allowed = result.candidates, result.rotations
    assert result.num_starts == box_index.num_starts
    places = (box_index.starts[found.starts] - torch.from_numpy(box_pose.position).float()).norm(dim=-1)
    angles = rotation_angle(allowed[found.rotations], torch.from_numpy(box_pose.rotation).float())
    near = (places < 0.6) & (angles < math.radians(20))
    assert bool(near[:8].any())


def test_the_first_pass_discards_starts_and_keeps_the_best_pose(box_index: MapIndex, box_panorama: Panorama) -> None:
    thorough, hasty = (
        SearchConfig(coarse_kept_starts=10_000),
        SearchConfig(coarse_kept_starts=10, coarse_kept_share=0.04),
    )
    rotations = make_search_rotations(hasty, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, hasty)
    (every,), (few,) = (
        search_maps([described], [box_index], rotations, [PoseLimits()], config) for config in (thorough, hasty)
    )
    assert few.num_poses < every.num_poses / 2
    assert few.num_starts == every.num_starts
    best = [(int(found.candidates.starts[0]), int(found.candidates.rotations[0])) for found in (every, few)]
    assert best[0] == best[1]


def test_the_first_pass_compares_starts_of_all_maps(box_index: MapIndex, box_panorama: Panorama) -> None:
    # The same map twice, the second one with its descriptors shuffled so that nothing in it looks like the panorama.
    config = SearchConfig(coarse_kept_starts=8, coarse_kept_share=0.01)
    views = box_index.descriptors
    order = torch.randperm(views.values.shape[1], generator=torch.Generator().manual_seed(0))
    shuffled = ViewDescriptors(views.values[:, order], views.basis, views.weights)
    maps = [box_index, replace(box_index, descriptors=shuffled)]
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, config)
    rotations = make_search_rotations(config, torch.device("cpu"))
    right, wrong = search_maps([described] * 2, maps, rotations, [PoseLimits()] * 2, config)
    assert len(right.candidates) > len(wrong.candidates)


def test_more_rotations_do_not_change_the_score_of_a_pose() -> None:
    # The tensor is the same; rotations only gather from it.
    from core.describe.spherical_patches import PatchGrid, rotation_table
    from core.search.pose_scores import score_poses

    grid = PatchGrid(4, 8)
    tensor = torch.rand((5, 32, 32), generator=torch.Generator().manual_seed(0))
    table = rotation_table(grid, uniform_rotations(300))
    weights = grid.polar_sines()
    torch.testing.assert_close(score_poses(tensor, table, weights)[:, :40], score_poses(tensor, table[:40], weights))


# Limits.


def test_limits_widen_for_the_search_and_not_for_the_answer() -> None:
    limits = PoseLimits(center=torch.zeros(3), radius_m=1.0, max_tilt=math.radians(10))
    assert bool(limits.searched_starts(torch.tensor([[1.3, 0.0, 0.0]])))
    assert not bool(limits.allows_position(torch.tensor([1.3, 0.0, 0.0])))
    tilted = torch.tensor(
        [
            [1.0, 0, 0],
            [0, math.cos(math.radians(15)), -math.sin(math.radians(15))],
            [0, math.sin(math.radians(15)), math.cos(math.radians(15))],
        ]
    )
    assert bool(limits.searched_rotations(tilted[None]))
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
