"""Starts: in free space, dense enough, and not too many."""

import numpy as np
import pytest

from panoloc.core.config import StartsConfig
from panoloc.core.errors import OptionsError
from panoloc.core.index.starts import octree_starts
from panoloc.core.options import IndexOptions
from tests.core.painted_box import PaintedBox


@pytest.fixture(scope="module")
def room_points() -> np.ndarray:
    return PaintedBox(size_m=(6.0, 5.0, 2.6)).scan(30_000).positions


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


def test_strays_far_outside_do_not_spend_the_starts(room_points: np.ndarray) -> None:
    strays = np.random.default_rng(2).uniform(-300, 300, (20, 3)).astype(np.float32)
    starts = octree_starts(np.concatenate((room_points, strays)), StartsConfig()).positions
    inside = ((starts > -0.5) & (starts < (6.5, 5.5, 3.1))).all(axis=1)
    assert inside.mean() > 0.9


@pytest.mark.parametrize("extent_m", [300.0, 1e7])
def test_a_scan_of_any_extent_gives_a_bounded_number_of_starts(extent_m: float) -> None:
    points = np.random.default_rng(0).uniform(0, extent_m, (500, 3)).astype(np.float32)
    starts = octree_starts(points, StartsConfig(max_starts=50, max_cells=100_000))
    assert 1 <= len(starts) <= 50
    assert bool((starts.positions >= 0).all())
    assert bool((starts.positions <= extent_m).all())


@pytest.mark.parametrize(
    "options",
    [{"starts_method": "random"}, {"spacing_m": 0.01}, {"color_kind": "grey"}, {"region": ((0, 0, 0), (1, 0, 1))}],
)
def test_index_options_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(OptionsError):
        IndexOptions(**options)  # type: ignore[arg-type]
