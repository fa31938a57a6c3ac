"""What registration keeps of a scan, against the same steps taken for one start at a time."""

import itertools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch

from panoloc.core.config import DescriptorConfig, IndexConfig, StartsConfig
from panoloc.core.features.described_views import described_histograms
from panoloc.core.features.patch_descriptors import centered_roots, principal_basis
from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.wall_axes import surface_thickness, wall_axes
from panoloc.core.options import IndexOptions, StartsMethod
from panoloc.core.render.render_cloud import point_spacing
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.painted_box import PaintedBox

DESCRIPTORS = DescriptorConfig(view_height=16, bins=4, size=6, basis_views=5)
CONFIG = IndexConfig(starts=StartsConfig(min_coverage_share=0.9), descriptors=DESCRIPTORS)
# Starts inside of the box and beside it, more than are rendered at once.
OPTIONS = IndexOptions("grid", 1.0, region=((1.0, 1.0, 0.5), (9.0, 3.0, 2.0)))
HEIGHT, WIDTH = 16, 32


@pytest.fixture(scope="module")
def scan() -> PointCloud:
    return PaintedBox().scan(3000, origin_offset=np.array([100.0, -20.0, 3.0]))


@pytest.fixture(scope="module", params=["rgb", "labels"])
def index(request: pytest.FixtureRequest, scan: PointCloud) -> MapIndex:
    region = tuple(tuple((np.array(corner) + scan.origin_offset).tolist()) for corner in OPTIONS.region or ())
    cloud = scan if request.param == "rgb" else PaintedBox(palette=((0, 0, 0), (250, 9, 9), (0, 99, 255))).scan(3000)
    options = IndexOptions("grid", 1.0, region if request.param == "rgb" else OPTIONS.region, request.param)  # type: ignore[arg-type]
    return build_map_index(cloud, options, config=CONFIG)


def described_one_by_one(index: MapIndex) -> tuple[list[torch.Tensor], list[float], list[float]]:
    """Return histograms (P, M), coverage and the share of pixels with a point of all 16 starts of the grid, in its order."""
    solid = pixel_solid_angles(HEIGHT, WIDTH).expand(-1, WIDTH)
    histograms, coverage, sampled = [], [], []
    for x, y, z in itertools.product(1.5 + np.arange(8), (1.5, 2.5), (0.875, 1.625)):
        views = render_views(index.render_cloud, torch.tensor([[x, y, z]]).float(), HEIGHT)
        weights = views.valid * solid
        made = described_histograms(views.color, weights, PatchGrid(4, 8), 4, index.labels is not None)
        histograms.append(made[0])
        coverage.append(float(weights.sum() / solid.sum()))
        sampled.append(float(((views.point[0] >= 0) * solid).sum() / solid.sum()))
    return histograms, coverage, sampled


@pytest.mark.slow
def test_each_start_is_described_by_what_is_seen_from_it_and_those_that_see_little_are_left_out(
    index: MapIndex,
) -> None:
    histograms, coverage, sampled = described_one_by_one(index)
    least = 0.9 * max(coverage)
    kept = [k for k, share in enumerate(coverage) if share >= least]
    assert 8 < len(kept) < len(coverage) == 32
    assert index.num_starts == len(kept)
    roots, weights = centered_roots(torch.stack(histograms), PatchGrid(4, 8).solid_angles())
    basis = principal_basis(roots[:: len(roots) // 5], 6)
    found, described = index.views, index.views.descriptors()
    # Directions are the same up to their sign.
    signs = (basis * found.basis).sum(0).sign()
    torch.testing.assert_close(found.basis, basis * signs, atol=2e-3, rtol=0)
    assert int(found.steps.abs().amax()) == DESCRIPTORS.steps
    rounded = (described.values - roots[kept] @ found.basis).abs().amax((1, 2))
    assert bool((rounded <= found.scale / 2 * 1.01).all())
    torch.testing.assert_close(described.weights, weights[kept], atol=0, rtol=1e-3)
    assert index.sampled_shares.tolist() == pytest.approx([sampled[k] for k in kept], abs=1e-5)
    assert index.leaf_sizes.tolist() == pytest.approx([1.0] * len(kept))


def test_colours_and_spacing_are_those_of_the_scan(index: MapIndex) -> None:
    assert index.spacing == pytest.approx(point_spacing(index.positions))
    colors = index.render_cloud.colors
    if index.labels is None:
        assert 0.1 < float(colors[:, :3].max()) <= 1
    else:
        codes = {tuple(code) for code in index.labels.codes.tolist()}
        assert {tuple(row) for row in colors[colors[:, -1] > 0][:, :3].tolist()} <= codes


def test_points_closer_together_than_anything_needs_are_merged() -> None:
    rng = np.random.default_rng(0)
    dense = PointCloud(rng.uniform(0, 0.5, (20_000, 3)).astype(np.float32), np.zeros((20_000, 3), np.uint8))
    for config, fewest, most in (
        (IndexConfig(descriptors=DESCRIPTORS, finest_spacing_m=0.1, finest_spacing_share=1.0), 60, 400),
        (IndexConfig(descriptors=DESCRIPTORS, finest_spacing_m=9.0, finest_spacing_share=0.1), 100, 1000),
        (IndexConfig(descriptors=DESCRIPTORS, finest_spacing_m=0.0), 20_000, 20_000),
    ):
        index = build_map_index(dense, IndexOptions("grid", 0.5), config=config)
        assert fewest <= index.num_points <= most


def test_the_spacing_of_starts_is_the_one_asked_for(scan: PointCloud) -> None:
    methods: tuple[StartsMethod, ...] = get_args(StartsMethod)
    for method in methods:
        wide, narrow = (build_map_index(scan, IndexOptions(method, spacing), config=CONFIG) for spacing in (2.0, 1.0))
        assert narrow.num_starts > 2 * wide.num_starts
        assert set(wide.leaf_sizes.tolist()) <= {2.0, 1.0, 0.5}
        assert set(narrow.leaf_sizes.tolist()) <= {1.0, 0.5, 0.25}


def test_progress_tells_how_many_starts_are_rendered(scan: PointCloud) -> None:
    told: list[tuple[str, float]] = []
    build_map_index(scan, OPTIONS, config=CONFIG, progress=lambda stage, share: told.append((stage, share)))
    rendering = [share for stage, share in told if stage == "rendering starts"]
    assert rendering == pytest.approx([0.0, 0.25, 0.5, 0.75])
    assert [each for each in told if each[0] != "rendering starts"] == [
        ("finding starts", 0.0),
        ("describing views", 0.0),
        ("describing views", 1.0),
    ]


def test_axes_of_the_walls_and_how_thick_these_are_belong_to_an_index() -> None:
    cloud, rng = PaintedBox().scan(20_000), np.random.default_rng(0)
    turn = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]])
    positions = (cloud.positions @ turn.T + 0.01 * rng.normal(size=cloud.positions.shape)).astype(np.float32)
    index = build_map_index(replace(cloud, positions=positions), IndexOptions("grid", 2.0), config=CONFIG)
    torch.testing.assert_close(index.wall_axes, torch.from_numpy(turn.T).float(), atol=0.01, rtol=0)
    assert torch.equal(index.wall_axes, wall_axes(index.positions))
    assert index.surface_thickness_m == surface_thickness(index.positions) > 0.005
