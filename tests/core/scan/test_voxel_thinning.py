"""Thinning: bounded, even, deterministic, and honest about labels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.voxel_thinning import VoxelThinner, group_by_voxel, thin_cloud


def random_cloud(seed: int, num_points: int, kind: str) -> PointCloud:
    rng = np.random.default_rng(seed)
    positions = rng.random((num_points, 3)) * [6, 5, 3]
    if kind == "walls":
        axis = rng.integers(0, 3, num_points)
        positions[np.arange(num_points), axis] = 0
    elif kind == "stray":
        positions[: num_points // 50 + 1] *= 1e7
    elif kind == "line":
        positions[:, 1:] = 1.0
    elif kind == "heap":
        positions[num_points // 10 :] = positions[0]
    colors = rng.integers(0, 256, (num_points, 3), dtype=np.uint8)
    return PointCloud(positions.astype(np.float32), colors, np.array([5.0, 6.0, 7.0]), num_points)


clouds = st.builds(
    random_cloud,
    st.integers(0, 10_000),
    st.integers(1, 3000),
    st.sampled_from(["volume", "walls", "stray", "line", "heap"]),
)


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(clouds, st.integers(1, 2000))
def test_never_more_than_asked_inside_the_bounds_and_the_same_every_time(cloud: PointCloud, max_points: int) -> None:
    thinned = thin_cloud(cloud, max_points)
    assert 1 <= len(thinned) <= max_points
    assert (thinned.bounds[0] >= cloud.bounds[0]).all()
    assert (thinned.bounds[1] <= cloud.bounds[1]).all()
    np.testing.assert_array_equal(thinned.origin_offset, cloud.origin_offset)
    again = thin_cloud(cloud, max_points)
    np.testing.assert_array_equal(thinned.positions, again.positions)
    np.testing.assert_array_equal(thinned.colors, again.colors)
    assert thin_cloud(thinned, max_points) is thinned


@settings(max_examples=40, deadline=None)
@given(clouds, st.integers(1, 500))
def test_labels_are_picked_from_the_points_never_made_up(cloud: PointCloud, max_points: int) -> None:
    thinned = thin_cloud(cloud, max_points, color_kind="labels")
    assert len(thinned) <= max_points
    assert set(map(tuple, rows_of(thinned))) <= set(map(tuple, rows_of(cloud)))


def rows_of(cloud: PointCloud) -> list[list[float]]:
    rows: list[list[float]] = np.concatenate([cloud.positions, cloud.colors], axis=1).tolist()
    return rows


def reference_groups(positions: NDArray[np.float64], size: float) -> list[list[int]]:
    """The slow and obvious twin of group_by_voxel."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for number, position in enumerate(positions):
        groups.setdefault(tuple(int(np.floor(value / size)) for value in position), []).append(number)
    return [groups[cell] for cell in sorted(groups)]


@pytest.mark.parametrize("spread", [1.0, 1e5, 1e12])
def test_grouping_agrees_with_its_obvious_twin_at_every_extent(spread: float) -> None:
    rng = np.random.default_rng(5)
    positions = np.concatenate([rng.random((300, 3)) * 4 - 2, rng.random((5, 3)) * spread])
    groups = group_by_voxel(positions, 0.5, np.zeros(3))
    found = [part.tolist() for part in np.split(groups.order, groups.starts[1:])]
    assert found == reference_groups(positions, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("max_points", [2_000, 30_000])
def test_walls_are_thinned_to_nearly_as_many_points_as_allowed(max_points: int) -> None:
    cloud = random_cloud(1, 150_000, "walls")
    assert 0.9 * max_points <= len(thin_cloud(cloud, max_points)) <= max_points


def test_many_points_of_which_few_are_distinct_are_thinned_to_these() -> None:
    rng = np.random.default_rng(3)
    distinct = rng.uniform(-5, 5, (100, 3))
    thinner = VoxelThinner(500)
    positions = np.repeat(distinct, 50, axis=0)
    thinner.add(positions, np.zeros((len(positions), 3), np.uint8))
    thinned = thinner.finish()
    assert len(thinned.positions) == 100
    np.testing.assert_allclose(sorted(map(tuple, thinned.positions)), sorted(map(tuple, distinct)), atol=1e-6)
    assert thinned.voxel_size is not None
    assert thinned.voxel_size > 1e-10


def test_a_voxel_keeps_the_mean_of_its_points() -> None:
    positions = np.array([[0, 0, 0], [0.2, 0, 0], [9, 9, 9], [9, 9, 9.1]], np.float32)
    colors = np.array([[10, 0, 0], [20, 0, 255], [7, 8, 9], [7, 8, 9]], np.uint8)
    thinned = thin_cloud(PointCloud(positions, colors), 2)
    np.testing.assert_allclose(thinned.positions, [[0.1, 0, 0], [9, 9, 9.05]], atol=1e-6)
    np.testing.assert_array_equal(thinned.colors, [[15, 0, 128], [7, 8, 9]])


@pytest.mark.parametrize("color_kind", ["rgb", "labels"])
def test_many_chunks_overflow_the_table_and_still_give_an_even_cloud(color_kind: str) -> None:
    rng = np.random.default_rng(2)
    thinner = VoxelThinner(8_000, color_kind)  # type: ignore[arg-type]
    for number in range(12):
        positions = rng.random((40_000, 3)) * [4, 3, 0] + [number % 3 * 4, number // 3 * 3, 0]
        shade = np.full((len(positions), 3), 10 + number * 20, np.uint8)
        thinner.add(positions, shade)
    thinned = thinner.finish()
    assert 4_000 <= len(thinned.positions) <= 8_000
    counts, _, _ = np.histogram2d(
        thinned.positions[:, 0], thinned.positions[:, 1], bins=(6, 6), range=((0, 12), (0, 12))
    )
    assert counts.min() > 0.8 * counts.max()
    station = (thinned.positions[:, 0] // 4 + thinned.positions[:, 1] // 3 * 3).astype(int)
    inside = (np.abs(thinned.positions[:, 0] % 4 - 2) < 1.8) & (np.abs(thinned.positions[:, 1] % 3 - 1.5) < 1.3)
    np.testing.assert_allclose(thinned.colors[inside, 0], 10 + station[inside] * 20)


@pytest.mark.parametrize("share", [0.4, 0.8, 0.97])
def test_a_cloud_slightly_too_large_keeps_most_of_its_points(share: float) -> None:
    rng = np.random.default_rng(5)
    count = 60_000
    walls = rng.uniform((0, 0, 0), (6, 5, 0.01), (count, 3)).astype(np.float32)
    cloud = PointCloud(walls, rng.integers(1, 255, (count, 3), dtype=np.uint8))
    limit = int(share * count)
    thinned = thin_cloud(cloud, limit)
    assert 0.7 * limit <= len(thinned) <= limit
