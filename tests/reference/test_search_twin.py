"""Histograms, intersections, score maps and pose scores against loops over their definitions."""

import numpy as np
import pytest
import torch

from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.patch_descriptors import DescribedPatches, patch_scores
from panoloc.core.features.patch_histograms import PatchGrid, soft_histograms
from panoloc.core.geometry.rotations import rotation_from_vector, uniform_rotations
from panoloc.core.paper.intersection import bin_major, hard_histograms, intersection_tensor, rotation_table
from panoloc.core.paper.paper_method import score_poses
from panoloc.core.paper.score_maps import (
    score_map_2d,
    score_map_3d,
    view_patch_scores,
)
from panoloc.core.search.map_search import patch_scores_of
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
    ("fast", "slow"),
    [
        (hard_histograms, twin.hard_histogram),
        (lambda color, *more: soft_histograms([color], *more), twin.soft_histogram),
        (lambda color, *more: soft_histograms([1 - color, color], *more)[..., 4**3 :], twin.soft_histogram),
    ],
    ids=["hard", "soft", "soft beside others"],
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


# Descriptors, on the grid that a map keeps and on those of patches taken together.


def made_views() -> DescribedViews:
    """Return three views of 8 x 16 patches, of some of which nothing was seen."""
    rng = np.random.default_rng(5)
    shares = rng.uniform(size=(3, 128)) * (rng.uniform(size=(3, 128)) < 0.8)
    weights = torch.from_numpy(shares / shares.sum(1, keepdims=True)).half()
    steps = torch.from_numpy(rng.integers(-31, 32, (3, 128, 5))).to(torch.int8) * (weights > 0)[..., None]
    nothing = torch.zeros(3)
    return DescribedViews(steps, torch.tensor([0.01, 0.03, 0.02]), nothing, weights, nothing, nothing)


def made_patches(grid: PatchGrid) -> DescribedPatches:
    """Return what a rig describes of a third of a grid."""
    rng = np.random.default_rng(6)
    numbers = np.sort(rng.choice(len(grid), len(grid) // 3, replace=False))
    values, weights = rng.normal(size=(len(numbers), 5)), rng.dirichlet(np.ones(len(numbers)))
    return DescribedPatches(
        torch.from_numpy(values).float(), torch.from_numpy(numbers), torch.from_numpy(weights).float(), grid
    )


@pytest.mark.parametrize("halvings", [0, 1, 2])
def test_scores_by_descriptors_agree_with_scalar_products_one_by_one(halvings: int) -> None:
    views, grid = made_views(), PatchGrid(8, 16).halved(halvings)
    patches = made_patches(grid)
    turns = rotation_from_vector(2 * torch.randn((6, 3), generator=torch.Generator().manual_seed(1)))
    values = views.steps.double().numpy() * views.scale.double().numpy()[:, None, None]
    weights = views.weights.double().numpy()
    for halving in range(halvings):
        values, weights = twin.taken_together(values, weights, 8 >> halving, 16 >> halving)
    table = twin.patch_table(turns.double().numpy(), grid.rows, grid.columns)[:, patches.numbers.numpy()]
    given = patches.values.double().numpy(), patches.weights.double().numpy()
    expected = twin.descriptor_scores(*given, values, weights, table)
    found = patch_scores(patches, views.descriptors(halvings), turns)
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-4, atol=1e-5)
    if not halvings:
        start, rotation = torch.tensor([2, 0, 1, 0]), torch.tensor([5, 1, 1, 3])
        some = patch_scores_of(patches, views, turns, start, rotation)
        np.testing.assert_allclose(some.numpy(), expected[start, rotation], rtol=1e-4, atol=1e-5)
