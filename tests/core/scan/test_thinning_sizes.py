"""Thinning must come near its limit from any density, not fall through to a handful of points."""

import numpy as np
import pytest

from core.scan.point_cloud import PointCloud
from core.scan.voxel_thinning import thin_cloud


@pytest.mark.parametrize("share", [0.4, 0.8, 0.97])
def test_a_cloud_slightly_too_large_keeps_most_of_its_points(share: float) -> None:
    rng = np.random.default_rng(5)
    count = 60_000
    walls = rng.uniform((0, 0, 0), (6, 5, 0.01), (count, 3)).astype(np.float32)
    cloud = PointCloud(walls, rng.integers(1, 255, (count, 3), dtype=np.uint8))
    limit = int(share * count)
    thinned = thin_cloud(cloud, limit)
    assert 0.7 * limit <= len(thinned) <= limit
