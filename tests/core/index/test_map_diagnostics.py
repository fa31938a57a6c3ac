"""Maps that can hardly serve say so, and the others do not."""

import numpy as np
import pytest

from core.index.map_builder import build_map_index
from core.index.map_diagnostics import map_diagnostics
from core.index.map_index import MapIndex
from core.options import IndexOptions
from core.scan.point_cloud import Diagnostic, PointCloud
from tests.core.painted_box import PaintedBox

GRID = IndexOptions(starts_method="grid", spacing_m=1.0)


def found(cloud: PointCloud, options: IndexOptions = GRID) -> dict[str, Diagnostic]:
    return {each.code: each for each in map_diagnostics(build_map_index(cloud, options), options, len(cloud))}


def test_a_scanned_box_is_fit_for_use(box_index: MapIndex) -> None:
    assert map_diagnostics(box_index, IndexOptions(), box_index.num_points) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("num_colored", "is_said"), [(0, True), (250, True), (400, False)])
def test_a_scan_with_hardly_any_colours_says_so(num_colored: int, is_said: bool) -> None:
    cloud = PaintedBox(size_m=(3.0, 3.0, 2.5)).scan(6000)
    rng = np.random.default_rng(0)
    colors = rng.integers(122, 127, cloud.colors.shape, np.uint8)
    colors[rng.permutation(len(colors))[:num_colored]] = (200, 10, 10)
    diagnostics = found(PointCloud(cloud.positions, colors))
    assert ("hardly_any_colors" in diagnostics) is is_said
    if is_said:
        assert "nearly the same colour (124, 124, 124)" in diagnostics["hardly_any_colors"].message


@pytest.mark.slow
def test_labels_may_be_few(box: PaintedBox) -> None:
    cloud = box.scan(6000)
    options = IndexOptions("grid", 1.0, color_kind="labels")
    alike = PointCloud(cloud.positions, np.full_like(cloud.colors, 7))
    assert "hardly_any_colors" not in found(alike, options)


@pytest.mark.slow
def test_a_wall_alone_surrounds_no_start() -> None:
    rng = np.random.default_rng(0)
    wall = rng.uniform(0, 5, (20_000, 3)) * (0.01, 1, 1)
    cloud = PointCloud(wall.astype(np.float32), rng.integers(0, 255, (20_000, 3)).astype(np.uint8))
    diagnostics = found(cloud, IndexOptions())
    assert list(diagnostics) == ["starts_see_little"]
    assert "of the view" in diagnostics["starts_see_little"].message
