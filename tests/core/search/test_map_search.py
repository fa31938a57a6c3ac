"""The search over made-up maps, small enough to be scored pose by pose, and once over a box; and its choice of candidates."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.camera.panorama import Panorama
from panoloc.core.config import DescriptorConfig, PoseDistance, SearchConfig
from panoloc.core.features.equalization import label_codes
from panoloc.core.features.patch_descriptors import ViewDescriptors, centered_roots, pooled
from panoloc.core.features.patch_grid import PatchGrid, rotation_table
from panoloc.core.features.patch_histograms import described_histograms
from panoloc.core.geometry.pose import pose_error
from panoloc.core.geometry.rotations import rotation_from_vector, uniform_rotations
from panoloc.core.image.pyramid import PanoramaPyramid
from panoloc.core.search.map_search import DescribedPanorama, describe_panorama, make_search_rotations, search_maps
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.pose_scores import select_candidates
from tests.core.built_maps import BOX, POSE, map_of, panorama
from tests.core.search.found_candidates import poses_of
from tests.reference import search_twin as twin

GRID = PatchGrid(4, 8)
PATCHES, SIZE, BINS = 32, 5, 11
# Every pose is a candidate of its own.
CONFIG = SearchConfig(
    num_rotations=30,
    coarse_rotations=12,
    coarse_kept_starts=100,
    coarse_kept_share=0.0,
    num_candidates=10_000,
    distinct=PoseDistance(1e-3, 1e-3),
)
NO_LIMITS = PoseLimits()


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def made_map(num_starts: int, seed: int) -> Any:
    """Return what the search needs of an index: starts 1 m apart along x, and descriptors of their views."""
    weights = random(num_starts, PATCHES, seed=seed) + 0.5
    views = ViewDescriptors(
        random(num_starts, PATCHES, SIZE, seed=seed + 1) - 0.5,
        random(BINS, SIZE, seed=seed + 2) - 0.5,
        weights / weights.sum(1, keepdim=True),
    )
    starts = torch.arange(num_starts)[:, None] * torch.tensor([1.0, 0.0, 0.0])
    values, coarse_weights = pooled(views.values, views.weights)
    coarse = ViewDescriptors(values, views.basis, coarse_weights)
    return SimpleNamespace(starts=starts, descriptors=views, coarse_views=coarse)


def made_panorama(seed: int = 50) -> DescribedPanorama:
    weights = random(PATCHES, seed=seed) + 0.5
    return DescribedPanorama(random(PATCHES, BINS, seed=seed + 1) - 0.5, weights / weights.sum())


def scores_of(query: np.ndarray, weights: np.ndarray, views: ViewDescriptors, table: torch.Tensor) -> np.ndarray:
    """Return scores (T, R), pose by pose: similarities of patches, divided by their weighted deviation in each view."""
    tensor = np.einsum("pd,tqd->tpq", query, views.values.double().numpy())
    for t, view_weights in enumerate(views.weights.double().numpy()):
        tensor[t] /= math.sqrt(weights @ tensor[t] ** 2 @ view_weights)
    return twin.pose_scores(tensor, table.numpy(), weights)


def full_scores(panorama: DescribedPanorama, index: Any, rotations: torch.Tensor) -> np.ndarray:
    query = (panorama.roots @ index.descriptors.basis).double().numpy()
    return scores_of(query, panorama.weights.double().numpy(), index.descriptors, rotation_table(GRID, rotations))


def coarse_scores(panorama: DescribedPanorama, index: Any, rotations: torch.Tensor) -> np.ndarray:
    query = panorama.roots @ index.descriptors.basis
    values, weights = pooled(query[None], panorama.weights[None])
    table = rotation_table(PatchGrid(2, 4), rotations)
    return scores_of(values[0].double().numpy(), weights[0].double().numpy(), index.coarse_views, table)


def search(maps: list[Any], limits: list[PoseLimits], config: SearchConfig = CONFIG, seed: int = 50) -> list[Any]:
    rotations = make_search_rotations(config, GRID, torch.device("cpu"))
    panoramas = [made_panorama(seed + k) for k in range(len(maps))]
    return list(search_maps(panoramas, maps, rotations, limits, config))


def assert_scored(found: Any, expected: np.ndarray, starts: list[int]) -> None:
    """Check that the candidates are all poses of `starts`, by falling score, with the scores (T, R) expected."""
    assert len(found.candidates) == len(starts) * expected.shape[1]
    assert found.candidates.scores.tolist() == sorted(found.candidates.scores.tolist(), reverse=True)
    assert sorted(set(found.candidates.starts.tolist())) == starts
    of_candidates = expected[found.candidates.starts.numpy(), found.candidates.rotations.numpy()]
    np.testing.assert_allclose(found.candidates.scores.numpy(), of_candidates, rtol=1e-3, atol=1e-4)


def test_every_pose_of_every_map_is_scored() -> None:
    maps = [made_map(4, 1), made_map(3, 7)]
    for k, found in enumerate(search(maps, [NO_LIMITS] * 2)):
        assert_scored(found, full_scores(made_panorama(50 + k), maps[k], uniform_rotations(30)), list(range(4 - k)))
        assert (found.num_starts, found.num_poses) == (4 - k, (4 - k) * 30)
        assert torch.equal(found.rotations, uniform_rotations(30))


def test_the_first_pass_keeps_the_starts_that_it_likes_best_over_all_maps() -> None:
    maps = [made_map(6, 1), made_map(5, 7)]
    config = SearchConfig(**{**vars(CONFIG), "coarse_kept_starts": 7, "coarse_kept_share": 0.1})
    best = [coarse_scores(made_panorama(50 + k), maps[k], uniform_rotations(12)).max(1) for k in range(2)]
    least = sorted(np.concatenate(best))[-7]
    assert 0 < sum(best[1] >= least) < 5
    for k, found in enumerate(search(maps, [NO_LIMITS] * 2, config)):
        kept = [t for t, score in enumerate(best[k]) if score >= least]
        assert kept
        assert_scored(found, full_scores(made_panorama(50 + k), maps[k], uniform_rotations(30)), kept)
        assert found.num_starts == 6 - k
        assert found.num_poses == (6 - k) * 12 + len(kept) * 30


@pytest.mark.parametrize(
    ("starts", "share", "kept"), [(4, 0.0, 4), (4, 0.5, 6), (1, 0.3, 3), (12, 0.1, 11), (11, 0.1, 11)]
)
def test_a_share_of_the_starts_goes_on_and_a_number_in_any_case(starts: int, share: float, kept: int) -> None:
    config = SearchConfig(**{**vars(CONFIG), "coarse_kept_starts": starts, "coarse_kept_share": share})
    (found,) = search([made_map(11, 1)], [NO_LIMITS], config)
    assert len(set(found.candidates.starts.tolist())) == kept
    assert found.num_poses == kept * 30 + (11 * 12 if kept < 11 else 0)


def test_hints_leave_starts_and_rotations_out() -> None:
    limits = PoseLimits(center=torch.tensor([2.0, 0.0, 0.0]), radius_m=0.9, max_tilt=math.radians(50))
    index = made_map(6, 1)
    (found,) = search([index], [limits])
    allowed = limits.searched_rotations(uniform_rotations(30), CONFIG.hint_margin_deg)
    assert 0 < int(allowed.sum()) < 30
    assert torch.equal(found.rotations, uniform_rotations(30)[allowed])
    assert_scored(found, full_scores(made_panorama(), index, found.rotations), [1, 2, 3])
    assert (found.num_starts, found.num_poses) == (3, 3 * int(allowed.sum()))


def test_hints_that_leave_nothing_are_answered_with_nothing() -> None:
    far = PoseLimits(center=torch.tensor([99.0, 0.0, 0.0]), radius_m=1.0)
    level = PoseLimits(max_tilt=0.0)  # no rotation is as level as that
    config = SearchConfig(**{**vars(CONFIG), "hint_margin_deg": 0.0})
    for limits in (far, level):
        (found,) = search([made_map(4, 1)], [limits], config)
        assert len(found.candidates) == len(found.candidates.rotations) == len(found.candidates.scores) == 0
        assert (found.num_starts, found.num_poses) == (0, 0)


def test_starts_that_the_first_pass_cannot_judge_go_on() -> None:
    # Of the few rotations of the first pass the hints leave none, of the many some.
    wanted = uniform_rotations(30)[:, 2, 2].max()
    narrow = PoseLimits(max_tilt=math.acos(float(wanted)) - math.radians(CONFIG.hint_margin_deg) + 0.01)
    config = SearchConfig(**{**vars(CONFIG), "coarse_rotations": 1, "coarse_kept_starts": 2})
    rotations = make_search_rotations(config, GRID, torch.device("cpu"))
    assert not bool(narrow.searched_rotations(rotations.coarse.rotations, config.hint_margin_deg).any())
    (found,) = search([made_map(4, 1)], [narrow], config)
    assert sorted(set(found.candidates.starts.tolist())) == [0, 1, 2, 3]
    assert found.num_poses == 4 * len(found.rotations) > 0


@pytest.mark.parametrize("labels", [False, True])
def test_a_panorama_is_described_as_the_views_of_a_map_are(labels: bool) -> None:
    config = DescriptorConfig(patch_rows=4, patch_columns=8, view_height=16, bins=4)
    rng = np.random.default_rng(0)
    palette = np.array([[0, 0, 0], [250, 20, 20], [20, 20, 250]], np.uint8)
    color = palette[rng.integers(0, 3, (64, 128))] if labels else rng.integers(0, 256, (64, 128, 3)).astype(np.uint8)
    valid = np.ones((64, 128), bool)
    valid[:16, :64] = False
    codes = label_codes(torch.from_numpy(np.repeat(palette, 50, 0))) if labels else None
    pyramid = PanoramaPyramid(Panorama(color, valid), 64, codes, "cpu")
    found = describe_panorama(pyramid, codes, config)
    level = pyramid.level(16)
    histogram = described_histograms(
        level.color.permute(1, 2, 0)[None],
        level.canonical(codes).permute(1, 2, 0).flatten(0, 1)[None],
        level.valid[None],
        level.weights()[None],
        GRID,
        4,
        labels,
    )
    roots, weights = centered_roots(histogram, GRID.solid_angles())
    torch.testing.assert_close(found.roots, roots[0])
    torch.testing.assert_close(found.weights, weights[0])
    assert float(found.weights[:4].sum()) == 0  # the masked part
    assert float(found.weights.sum()) == pytest.approx(1)


def test_the_search_ranks_a_pose_near_the_true_one_among_the_first() -> None:
    config, index = SearchConfig(), map_of(BOX)
    grid = PatchGrid(DescriptorConfig().patch_rows, DescriptorConfig().patch_columns)
    rotations = make_search_rotations(config, grid, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(panorama(), 64, None, "cpu"), None, DescriptorConfig())
    (found,) = search_maps([described], [index], rotations, [NO_LIMITS], config)
    assert found.num_starts == index.num_starts
    assert any(pose_error(pose, POSE).within(0.6, 20.0) for pose in poses_of(found, index)[:8])


# Candidates when many of the best poses are nearly the same, or excluded.


def poses(num_alike: int, num_elsewhere: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return scores (T, R), starts (T, 3) and rotations (R, 3, 3): the best poses are all alike at the first start, then one
    at each of the other starts, and nothing else is allowed."""
    tiny = torch.linspace(0, 0.01, num_alike)[:, None] * torch.tensor([0.0, 0.0, 1.0])
    scores = torch.full((1 + num_elsewhere, num_alike), -math.inf)
    scores[0] = torch.linspace(2, 1, num_alike)
    scores[1:, 0] = torch.linspace(0.9, 0.5, num_elsewhere)
    starts = torch.zeros((1 + num_elsewhere, 3))
    starts[:, 0] = torch.arange(1 + num_elsewhere) * 2.0
    return scores, starts, torch.stack([rotation_from_vector(turn) for turn in tiny])


def test_when_too_few_of_the_best_poses_differ_more_of_them_are_looked_at() -> None:
    scores, starts, rotations = poses(num_alike=600, num_elsewhere=7)
    found = select_candidates(scores, starts, rotations, SearchConfig(num_candidates=8))
    assert found.starts.tolist() == list(range(8))
    assert found.rotations.tolist() == [0] * 8
    torch.testing.assert_close(found.scores, torch.cat((torch.tensor([2.0]), torch.linspace(0.9, 0.5, 7))))


def test_of_poses_that_hardly_differ_only_the_best_is_a_candidate_however_few_there_are() -> None:
    scores, starts, rotations = poses(num_alike=20, num_elsewhere=2)
    found = select_candidates(scores, starts, rotations, SearchConfig(num_candidates=8))
    assert found.starts.tolist() == [0, 1, 2]
    assert len(found) == 3


def test_the_same_place_seen_another_way_and_another_place_seen_the_same_way_are_other_poses() -> None:
    turned = torch.stack([rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(a)])) for a in (0.0, 24.0, 26.0)])
    starts = torch.tensor([[0.0, 0, 0], [0.7, 0, 0], [0.9, 0, 0]])
    scores = torch.tensor([[9.0, 8.0, 7.0], [6.0, 5.0, 1.0], [4.0, -math.inf, -math.inf]])
    found = select_candidates(scores, starts, turned, SearchConfig(num_candidates=9))
    assert list(zip(found.starts.tolist(), found.rotations.tolist(), strict=True)) == [(0, 0), (0, 2), (2, 0)]


def test_excluded_poses_are_never_candidates() -> None:
    scores = torch.full((3, 5), -math.inf)
    scores[1, 2] = 0.5
    chosen = select_candidates(scores, torch.zeros((3, 3)), uniform_rotations(5), SearchConfig(num_candidates=4))
    assert (chosen.starts.tolist(), chosen.rotations.tolist()) == ([1], [2])
