"""Registration: from a point cloud to a map index. The order of the steps is written here.

Paper: §3.1 to §3.3, the map side: starts, one synthetic view per start, patch histograms.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from panoloc.core.config import IndexConfig
from panoloc.core.features.described_views import ViewCollector
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.image.label_codes import label_codes
from panoloc.core.map.aliases import find_aliases
from panoloc.core.map.map_index import INDEX_VERSION, MapIndex
from panoloc.core.map.starts import Starts, grid_starts, octree_starts
from panoloc.core.map.wall_axes import surface_thickness, wall_axes
from panoloc.core.options import IndexOptions
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.core.render.synthetic_view import RENDER_BATCH, render_views
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.voxel_thinning import thin_to_spacing

Progress = Callable[[str, float], None]


def index_config_digest(options: IndexOptions, config: IndexConfig | None = None) -> str:
    """Return 16 hex digits that change whenever an index built with these options would."""
    text = f"{INDEX_VERSION} {(config or IndexConfig()).digest()} {options!r}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def build_map_index(
    cloud: PointCloud,
    options: IndexOptions | None = None,
    *,
    config: IndexConfig | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> MapIndex:
    """Build the index of a cloud.

    progress: called with the stage's name and its share done, 0..1; an exception raised there stops the work and passes through.
    Raises OptionsError when the options leave no start.
    """
    options, config = options or IndexOptions(), config or IndexConfig()
    report = progress or (lambda stage, share: None)
    report("finding starts", 0.0)
    cloud = _sort_along_curve(_thinned(cloud, options, config))
    starts = _find_starts(cloud, options, config)
    positions = torch.from_numpy(cloud.positions).to(device)
    raw = torch.from_numpy(cloud.colors).to(device)
    labels = label_codes(raw) if options.color_kind == "labels" else None
    colors = raw.float() / 255 if labels is None else labels.recode(raw)[0]
    spacing = point_spacing(positions)
    centers = torch.from_numpy(starts.positions).float().to(device)
    rendered = make_render_cloud(positions, colors, spacing)
    described = config.descriptors
    solid = pixel_solid_angles(described.view_height, 2 * described.view_height, device)

    def render(part: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return colours and weights of the views from centers (B, 3), and in which pixels (B, H, W) a point falls."""
        views = render_views(rendered, part, described.view_height)
        return views.color, views.valid * solid, views.point >= 0

    sample = map(render, torch.split(centers[:: max(1, len(centers) // described.basis_views)], RENDER_BATCH))
    color, weights, _ = (torch.cat(each) for each in zip(*sample, strict=True))
    collector = ViewCollector(described, labels is not None, color, weights)
    coverage, sampled_shares = [], []
    for first in range(0, len(centers), RENDER_BATCH):
        report("rendering starts", first / len(centers))
        color, weights, sampled = render(centers[first : first + RENDER_BATCH])
        collector.add(color, weights)
        coverage.append(weights.sum((1, 2)) / (4 * math.pi))
        sampled_shares.append((sampled * weights).sum((1, 2)) / (4 * math.pi))
    covered = torch.cat(coverage)
    # The others do not see enough to lie inside the scanned space.
    keep = (covered >= config.starts.min_coverage_share * covered.max()).nonzero()[:, 0]
    report("describing views", 0.0)
    found = collector.collected(keep)
    aliases = find_aliases(found, centers[keep], config.aliases)
    report("describing views", 1.0)
    return MapIndex(
        positions=positions,
        colors=raw,
        origin_offset=cloud.origin_offset,
        spacing=spacing,
        starts=centers[keep],
        leaf_sizes=torch.from_numpy(starts.leaf_sizes).float().to(device)[keep],
        views=found,
        sampled_shares=torch.cat(sampled_shares)[keep],
        aliases=aliases,
        wall_axes=wall_axes(positions),
        surface_thickness_m=surface_thickness(positions),
        labels=labels,
        num_points_read=cloud.num_points_read or len(cloud),
    )


def _find_starts(cloud: PointCloud, options: IndexOptions, config: IndexConfig) -> Starts:
    chosen = config.starts if options.spacing_m is None else replace(config.starts, spacing_m=options.spacing_m)
    region = None
    if options.region is not None:
        low, high = (np.asarray(corner) - cloud.origin_offset for corner in options.region)
        region = (low, high)
    find = octree_starts if options.starts_method == "octree" else grid_starts
    return find(cloud.positions, chosen, region)


def _thinned(cloud: PointCloud, options: IndexOptions, config: IndexConfig) -> PointCloud:
    lower, upper = cloud.bounds
    spacing = min(config.finest_spacing_m, config.finest_spacing_share * float(np.linalg.norm(upper - lower)))
    return thin_to_spacing(cloud, spacing, options.color_kind) if spacing > 0 else cloud


def _sort_along_curve(cloud: PointCloud) -> PointCloud:
    """Sort the points along a Morton curve: neighbours lie together in memory, and every k-th point is an even sample."""
    lower, upper = cloud.bounds
    scaled = (cloud.positions - lower) / max(float((upper - lower).max()), 1e-6) * 1023
    code = np.zeros(len(cloud), dtype=np.int64)
    cells = scaled.astype(np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    return replace(
        cloud, positions=np.ascontiguousarray(cloud.positions[order]), colors=np.ascontiguousarray(cloud.colors[order])
    )
