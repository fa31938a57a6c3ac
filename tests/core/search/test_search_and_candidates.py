"""The search over all starts and rotations, and the candidates that it names."""

import math
from dataclasses import replace

import numpy as np
import torch

from core.config import DescriptorConfig, SearchConfig
from core.describe.patch_descriptors import ViewDescriptors
from core.describe.spherical_patches import PatchGrid
from core.geometry.pose import Pose
from core.geometry.rotations import rotation_angle, uniform_rotations
from core.index.map_index import MapIndex
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaPyramid
from core.search.map_search import describe_panorama, make_search_rotations, search_maps
from core.search.pose_limits import PoseLimits
from core.search.pose_scores import select_candidates

GRID = PatchGrid(DescriptorConfig().patch_rows, DescriptorConfig().patch_columns)


def test_candidates_come_best_first_and_differ_from_each_other() -> None:
    rng = np.random.default_rng(3)
    positions = torch.from_numpy(rng.uniform(0, 4, (30, 3))).float()
    rotations = uniform_rotations(200)
    scores = torch.from_numpy(rng.normal(size=(30, 200))).float()
    chosen = select_candidates(scores, positions, rotations, SearchConfig(num_candidates=12))
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
    chosen = select_candidates(scores, torch.zeros((3, 3)), uniform_rotations(5), SearchConfig(num_candidates=4))
    assert chosen.starts.tolist() == [1]
    assert chosen.rotations.tolist() == [2]


def test_the_search_ranks_a_pose_near_the_true_one_among_the_first(
    box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    config = SearchConfig()
    rotations = make_search_rotations(config, GRID, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, DescriptorConfig())
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
    rotations = make_search_rotations(hasty, GRID, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, DescriptorConfig())
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
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, DescriptorConfig())
    rotations = make_search_rotations(config, GRID, torch.device("cpu"))
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
