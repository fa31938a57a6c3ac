"""Scans that are no buildings: the number of octree cells stays bounded whatever the extent."""

import numpy as np
import pytest

from core.config import StartsConfig
from core.index.starts import octree_starts


# One of both is as large as it gets.
@pytest.mark.parametrize(
    ("extent_m", "config"),
    [
        (300.0, StartsConfig(max_starts=50, max_cells=1_000_000)),
        pytest.param(1e7, StartsConfig(max_starts=50), marks=pytest.mark.slow),
    ],
)
def test_a_scan_of_any_extent_gives_a_bounded_number_of_starts(extent_m: float, config: StartsConfig) -> None:
    points = np.random.default_rng(0).uniform(0, extent_m, (500, 3)).astype(np.float32)
    starts = octree_starts(points, config)
    assert 1 <= len(starts) <= 50
    assert bool((starts.positions >= 0).all())
    assert bool((starts.positions <= extent_m).all())
