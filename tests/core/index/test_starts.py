"""Starts: in free space, dense enough, and not too many."""

import numpy as np
import pytest

from core.config import StartsConfig
from core.errors import OptionsError
from core.index.starts import grid_starts, octree_starts
from core.options import IndexOptions
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


@pytest.mark.slow
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
