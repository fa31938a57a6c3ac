"""Starts against recursion over cells, points and pairs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.config import StartsConfig
from panoloc.core.errors import OptionsError
from panoloc.core.map.starts import Starts, grid_starts, octree_starts
from panoloc.core.options import IndexOptions

Array = NDArray[np.float64]
Leaf = tuple[tuple[float, ...], float]


def octree_leaves(points: Array, lower: Array, upper: Array, spacing: float, clearance: float) -> list[Leaf]:
    """Return centre and edge of the empty leaves whose middle keeps the clearance and lies within the bounds.

    The root cells, of edge `spacing`, are centred on the bounds; a cell that holds a point is divided, twice at most. The clearance is
    counted in cells of the smallest size, along each axis.
    """
    num = [max(1, int(np.ceil((high - low) / spacing))) for low, high in zip(lower, upper, strict=True)]
    origin = np.array([(low + high) / 2 - n * spacing / 2 for low, high, n in zip(lower, upper, num, strict=True)])
    smallest = spacing / 4
    occupied = {tuple(np.floor((point - origin) / smallest).astype(int)) for point in points}
    occupied = {cell for cell in occupied if all(0 <= c < 4 * n for c, n in zip(cell, num, strict=True))}
    taken, steps = np.array(sorted(occupied)), round(clearance / smallest)

    def leaves(corner: tuple[int, ...], side: int) -> list[Leaf]:
        inside = itertools.product(*(range(c, c + side) for c in corner))
        if not any(cell in occupied for cell in inside):
            middle = tuple(c + side // 2 for c in corner)
            if (np.abs(taken - middle).max(axis=1) <= steps).any():
                return []
            center = origin + (np.array(corner) + side / 2) * smallest
            return [(tuple(center), side * smallest)] if (lower <= center).all() and (center <= upper).all() else []
        if side == 1:
            return []
        half = side // 2
        corners = itertools.product(*((c, c + half) for c in corner))
        return [leaf for each in corners for leaf in leaves(each, half)]

    roots = itertools.product(*(range(0, 4 * n, 4) for n in num))
    return [leaf for root in roots for leaf in leaves(root, 4)]


def thinned(leaves: list[Leaf], distance: float) -> list[Leaf]:
    """Keep leaves, the largest first and then by z, y and x, that are at least `distance` from all kept before."""
    kept: list[Leaf] = []
    for center, edge in sorted(leaves, key=lambda leaf: (-leaf[1], leaf[0][2], leaf[0][1], leaf[0][0])):
        if all(np.linalg.norm(np.subtract(center, other)) >= distance for other, _ in kept):
            kept.append((center, edge))
    return kept


def slow_starts(points: Array, config: StartsConfig, region: tuple[Array, Array] | None = None) -> list[Leaf]:
    """Return the starts; the spacing grows until there are no more than `config.max_starts`."""
    lower, upper = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    if region is not None:
        lower, upper = np.maximum(lower, region[0]), np.minimum(upper, region[1])
    spacing = config.spacing_m
    while True:
        starts = thinned(octree_leaves(points, lower, upper, spacing, config.clearance_m), 0.75 * spacing)
        if len(starts) <= config.max_starts:
            return starts
        spacing *= max(1.02, (len(starts) / config.max_starts) ** (1 / 3))


def room(seed: int, size: tuple[float, float, float] = (2.3, 1.9, 1.4)) -> np.ndarray:
    """Return points (N, 3) float32 on the walls of a room with a cupboard in it, at some distance from the origin."""
    rng = np.random.default_rng(seed)
    walls = rng.uniform(0, 1, (500, 3))
    walls[np.arange(500), rng.integers(0, 3, 500)] = rng.integers(0, 2, 500)
    cupboard = rng.uniform((0.6, 0.1, 0.0), (0.9, 0.5, 0.7), (80, 3))
    points = np.concatenate((walls * size, cupboard)) + np.array([3.0, -5.0, 0.5])
    return np.asarray(points, np.float32)


def assert_as_slow(
    points: np.ndarray,
    config: StartsConfig,
    region: tuple[np.ndarray, np.ndarray] | None = None,
    slow_config: StartsConfig | None = None,
) -> Starts:
    """Check the starts against the twin's, and return them."""
    found = octree_starts(points, config, region)
    expected = slow_starts(points.astype(np.float64), slow_config or config, region)
    assert len(found) == len(expected) > 3
    np.testing.assert_allclose(found.positions, [center for center, _ in expected], rtol=1e-6)
    np.testing.assert_allclose(found.leaf_sizes, [edge for _, edge in expected], rtol=1e-6)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed_spacing_clearance", [(0, 0.5, 0.25), (1, 0.3, 0.1), (2, 0.4, 0.0), (3, 0.7, 0.2)])
def test_starts_are_the_empty_leaves_that_keep_clear_thinned_from_the_largest(
    seed_spacing_clearance: tuple[int, float, float],
) -> None:
    seed, spacing_m, clearance_m = seed_spacing_clearance
    assert_as_slow(room(seed), StartsConfig(spacing_m=spacing_m, clearance_m=clearance_m))


@pytest.mark.slow
def test_the_spacing_grows_until_there_are_few_enough() -> None:
    found = assert_as_slow(room(4), StartsConfig(spacing_m=0.3, clearance_m=0.1, max_starts=20))
    assert 8 < len(found) <= 20


def test_a_place_lower_than_the_spacing_has_one_layer_of_cells() -> None:
    points = room(10)
    assert_as_slow(points[points[:, 2] < 0.9], StartsConfig(spacing_m=0.5, clearance_m=0.1))


def test_within_a_region_the_leaves_are_those_of_the_region() -> None:
    region = np.array([3.5, -4.8, 0.3]), np.array([4.9, -3.7, 1.5])
    assert_as_slow(room(5), StartsConfig(spacing_m=0.4, clearance_m=0.1), region)


def test_a_place_without_a_free_leaf_still_gets_a_start_in_its_middle() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (20_000, 3)).astype(np.float32)
    starts = octree_starts(points, StartsConfig(spacing_m=0.5))
    assert starts.positions == pytest.approx(np.full((1, 3), 0.5), abs=0.01)
    assert starts.leaf_sizes.tolist() == [0.5]


@pytest.mark.parametrize("scale", [0.4, 1.5])
def test_a_scan_that_is_too_large_has_cells_that_fit_into_memory(scale: float) -> None:
    points = (room(8) * np.float32(scale)).astype(np.float32)
    lower, upper = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    volume = np.prod([max(side, 1.0) for side in upper - lower])
    least = 4 * (volume / 3000) ** (1 / 3)
    config = StartsConfig(spacing_m=0.1, clearance_m=0.1, max_cells=3000)
    assert_as_slow(points, config, slow_config=replace(config, spacing_m=float(least)))


@pytest.mark.parametrize(("spacing", "max_starts"), [(0.5, 800), (0.31, 800), (0.2, 60), (9.0, 800)])
def test_grid_starts_divide_every_axis_evenly(spacing: float, max_starts: int) -> None:
    points = room(6).astype(np.float64)
    lower, upper = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    step = spacing
    while True:
        counts = [max(1, round((high - low) / step)) for low, high in zip(lower, upper, strict=True)]
        if np.prod(counts) <= max_starts:
            break
        step *= 1.05
    expected = [
        [low + (k + 0.5) * (high - low) / n for k, low, high, n in zip(cell, lower, upper, counts, strict=True)]
        for cell in np.ndindex(*counts)
    ]
    found = grid_starts(room(6), StartsConfig(spacing_m=spacing, max_starts=max_starts))
    np.testing.assert_allclose(found.positions, expected, atol=1e-6)
    assert found.leaf_sizes.tolist() == pytest.approx([step] * len(expected))


def test_a_grid_of_a_region_reaches_all_of_it_and_no_further() -> None:
    region = np.array([0.0, 10.0, -3.0]), np.array([2.0, 13.0, -2.0])
    found = grid_starts(room(6), StartsConfig(spacing_m=1.0), region).positions
    assert sorted({tuple(each) for each in found.tolist()}) == [
        (x, y, -2.5) for x in (0.5, 1.5) for y in (10.5, 11.5, 12.5)
    ]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_region_without_room_is_refused(axis: int) -> None:
    low, high = np.array([3.5, -4.8, 0.8]), np.array([4.9, -3.7, 1.5])
    high[axis] = low[axis]
    for find in (octree_starts, grid_starts):
        with pytest.raises(OptionsError, match=r"starts\.region"):
            find(room(7), StartsConfig(), (low, high))


@pytest.mark.parametrize("extent_m", [300.0, 1e7])
def test_a_scan_of_any_extent_gives_a_bounded_number_of_starts(extent_m: float) -> None:
    points = np.random.default_rng(0).uniform(0, extent_m, (500, 3)).astype(np.float32)
    starts = octree_starts(points, StartsConfig(max_starts=50, max_cells=100_000))
    assert 1 <= len(starts) <= 50
    assert bool(((starts.positions >= 0) & (starts.positions <= extent_m)).all())


@pytest.mark.parametrize(
    "options",
    [{"starts_method": "random"}, {"spacing_m": 0.01}, {"color_kind": "grey"}, {"region": ((0, 0, 0), (1, 0, 1))}],
)
def test_index_options_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(OptionsError):
        IndexOptions(**options)  # type: ignore[arg-type]
