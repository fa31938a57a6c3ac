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


def moved(cloud: PointCloud, offset: tuple[float, float, float]) -> PointCloud:
    return PointCloud(cloud.positions, cloud.colors, np.array(offset), len(cloud))


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
@pytest.mark.parametrize("num_points", [2, 100, 999])
def test_a_map_of_few_points_says_how_many(box: PaintedBox, num_points: int) -> None:
    cloud = box.scan(3000)
    every = np.linspace(0, len(cloud) - 1, num_points).astype(int)
    diagnostics = found(PointCloud(cloud.positions[every], cloud.colors[every]))
    assert diagnostics["few_points"].severity == "warning"
    assert f"only {num_points} points" in diagnostics["few_points"].message


@pytest.mark.slow
def test_a_thousand_points_are_not_few(box: PaintedBox) -> None:
    cloud = box.scan(3000)
    assert "few_points" not in found(PointCloud(cloud.positions[:1000], cloud.colors[:1000]))


@pytest.mark.slow
def test_a_wall_alone_surrounds_no_start() -> None:
    rng = np.random.default_rng(0)
    wall = rng.uniform(0, 5, (20_000, 3)) * (0.01, 1, 1)
    cloud = PointCloud(wall.astype(np.float32), rng.integers(0, 255, (20_000, 3)).astype(np.uint8))
    diagnostics = found(cloud, IndexOptions())
    assert list(diagnostics) == ["starts_see_little"]
    assert "of the view" in diagnostics["starts_see_little"].message


@pytest.mark.slow
def test_starts_beside_the_scan_are_counted_and_said_to_see_little(box: PaintedBox) -> None:
    beside = IndexOptions("grid", 1.0, region=((30.0, 30.0, 0.5), (32.0, 33.0, 1.5)))
    diagnostics = found(box.scan(6000), beside)
    assert list(diagnostics) == ["starts_see_little", "region_outside_scan"]
    assert diagnostics["region_outside_scan"].severity == "warning"
    assert diagnostics["region_outside_scan"].message.startswith("6 of 6 starts lie outside of the scan ((")


@pytest.mark.slow
def test_starts_are_cut_to_the_scan_where_an_octree_meets_a_generous_region(box: PaintedBox) -> None:
    generous = IndexOptions(region=((-1.0, 1.0, 0.5), (9.0, 3.0, 1.8)))
    diagnostics = found(box.scan(6000), generous)
    assert {code: each.severity for code, each in diagnostics.items()} == {"region_outside_scan": "info"}


@pytest.mark.slow
def test_a_region_within_the_scan_is_no_matter_of_note_whatever_the_origin(box: PaintedBox) -> None:
    far = moved(box.scan(6000), (400_000.0, 5_000_000.0, 100.0))
    inside = IndexOptions("grid", 1.0, region=((400_001.0, 5_000_001.0, 100.5), (400_003.0, 5_000_003.0, 102.0)))
    assert found(far, inside) == {}
    assert "region_outside_scan" in found(far, IndexOptions("grid", 1.0, region=((1.0, 1.0, 0.5), (3.0, 3.0, 2.0))))


@pytest.mark.slow
def test_points_that_were_merged_are_told() -> None:
    cloud = PaintedBox(size_m=(3.0, 3.0, 2.5)).scan(300_000)
    diagnostics = found(cloud)
    assert "300,000 points became" in diagnostics["merged_points"].message
    assert diagnostics["merged_points"].severity == "info"
