"""Histograms, intersections, score maps and pose scores against loops over their definitions."""

import numpy as np
import pytest
import torch

from panoloc.core.features.patch_grid import PatchGrid, rotation_table
from panoloc.core.features.patch_histograms import hard_histograms, soft_histograms
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.paper.intersection import bin_major, intersection_tensor
from panoloc.core.paper.score_maps import (
    score_map_2d,
    score_map_3d,
    view_patch_scores,
)
from panoloc.core.search.pose_scores import score_poses
from tests.reference import search_twin as twin

ROWS, COLUMNS = 3, 6
PATCHES = ROWS * COLUMNS


@pytest.fixture(scope="module")
def rotations() -> np.ndarray:
    return uniform_rotations(12).double().numpy()


@pytest.fixture(scope="module")
def table(rotations: np.ndarray) -> np.ndarray:
    return twin.patch_table(rotations, ROWS, COLUMNS)


@pytest.fixture(scope="module")
def tensor() -> np.ndarray:
    return np.random.default_rng(0).uniform(size=(4, PATCHES, PATCHES))


@pytest.mark.parametrize(
    ("fast", "slow"), [(hard_histograms, twin.hard_histogram), (soft_histograms, twin.soft_histogram)]
)
def test_histograms_agree_with_counting_pixel_by_pixel(fast: object, slow: object) -> None:
    rng = np.random.default_rng(1)
    colors, weights = rng.uniform(size=(2, 40, 3)), rng.uniform(size=(2, 40))
    weights[rng.uniform(size=weights.shape) < 0.3] = 0.0
    patch = rng.integers(0, 4, 40)
    weights[0, patch == 2] = 0.0
    colors[0, :4] = np.array([[0, 0, 0], [1, 1, 1], [0.25, 0.5, 0.75], [0.999, 0.001, 1]])
    found = fast(  # type: ignore[operator]
        torch.from_numpy(colors).float(),
        torch.from_numpy(weights).float(),
        torch.from_numpy(patch).expand(2, -1),
        5,
        4,
    ).numpy()
    for view in range(2):
        for number in range(5):
            here = patch == number
            expected = slow(colors[view, here], weights[view, here], 4)  # type: ignore[operator]
            np.testing.assert_allclose(found[view, number], expected, atol=2e-6)


def test_the_intersection_tensor_agrees_with_sums_of_minima() -> None:
    rng = np.random.default_rng(2)
    query = rng.dirichlet(np.full(20, 0.1), size=5)
    views = rng.dirichlet(np.full(20, 0.1), size=(3, 5))
    query[rng.uniform(size=query.shape) < 0.5] = 0.0
    query[4] = 0.0
    found = intersection_tensor(torch.from_numpy(query), bin_major(torch.from_numpy(views)), 3)
    np.testing.assert_allclose(found.numpy(), twin.intersections(query, views), atol=1e-12)


def test_the_rotation_table_agrees_with_brute_force_over_all_centres(rotations: np.ndarray, table: np.ndarray) -> None:
    found = rotation_table(PatchGrid(ROWS, COLUMNS), torch.from_numpy(rotations).float()).numpy()
    assert (found != table).mean() < 0.01  # float32 against float64 at the border of two cells


def test_pose_scores_agree_with_the_weighted_sum(tensor: np.ndarray, table: np.ndarray) -> None:
    weights = np.random.default_rng(3).uniform(size=PATCHES)
    found = score_poses(torch.from_numpy(tensor), torch.from_numpy(table), torch.from_numpy(weights))
    np.testing.assert_allclose(found.numpy(), twin.pose_scores(tensor, table, weights), atol=1e-9)


def test_the_2d_score_map_is_the_best_match_over_views_and_rotations(tensor: np.ndarray, table: np.ndarray) -> None:
    found = score_map_2d(torch.from_numpy(tensor), torch.from_numpy(table))
    np.testing.assert_allclose(found.numpy(), twin.score_map_2d(tensor, table), atol=1e-12)


def test_the_3d_score_map_is_the_mean_over_views(tensor: np.ndarray, table: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    points, starts = rng.uniform(-3, 3, (60, 3)), rng.uniform(-0.5, 0.5, (4, 3))
    scores = view_patch_scores(torch.from_numpy(tensor), torch.from_numpy(table))
    found = score_map_3d(scores, torch.from_numpy(points), torch.from_numpy(starts), PatchGrid(ROWS, COLUMNS), chunk=7)
    expected = twin.score_map_3d(tensor, table, points, starts, ROWS, COLUMNS)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)
