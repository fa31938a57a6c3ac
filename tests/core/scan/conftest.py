"""A small coloured cloud, and a way to write files of every format by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.scan.point_cloud import PointCloud

NUM_POINTS = 60


@pytest.fixture
def cloud() -> PointCloud:
    """Points of a 4 x 3 x 2.5 m room whose coordinates survive three decimals, with colours of the whole range."""
    rng = np.random.default_rng(7)
    positions = np.round(rng.random((NUM_POINTS, 3)) * [4, 3, 2.5], 3).astype(np.float32)
    colors = rng.integers(0, 256, (NUM_POINTS, 3), dtype=np.uint8)
    colors[:2] = [[0, 0, 0], [255, 255, 255]]
    return PointCloud(positions, colors, num_points_read=NUM_POINTS)


@pytest.fixture
def scan_file(tmp_path: Path) -> Callable[[str, bytes | str], Path]:
    """Write a file into the test's folder and return its path."""

    def write(name: str, content: bytes | str) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


@pytest.fixture
def assert_same_points() -> Callable[..., None]:
    """Compare positions (with their offset) and colours point by point."""

    def compare(actual: PointCloud, expected: PointCloud, atol_m: float = 1e-6) -> None:
        np.testing.assert_allclose(
            actual.positions + actual.origin_offset, expected.positions + expected.origin_offset, rtol=0, atol=atol_m
        )
        np.testing.assert_array_equal(actual.colors, expected.colors)

    return compare
