"""The points that candidates are refined on: those seen from the start while poses are rough, those seen from the pose later.

Points behind a wall must not vote (docs/method.md): both kinds come out of a z-buffer.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.color_equalization import apply_tables, equalization_tables
from core.gauss_newton import CandidatePoints
from core.map_index import MapIndex
from core.panorama_pyramid import PanoramaLevel
from core.projection import pixel_directions, pixel_solid_angles, project, sample_bilinear
from core.sphere_points import even_directions
from core.synthetic_view import RenderCloud, SyntheticViews, make_render_cloud, render_views


def render_cloud(index: MapIndex) -> RenderCloud:
    """Return the index's points with canonical colours (as scanned, or label codes), ready for rendering."""
    return make_render_cloud(index.positions, index.canonical_cloud_colors(), index.spacing)


def points_seen_from_starts(index: MapIndex, starts: Tensor, coarse: bool) -> CandidatePoints:
    """Return the stored points (K, S) of the starts numbered `starts` (K,), with their canonical colours."""
    number = index.start_points[starts].long()
    colors = (index.start_colors_coarse if coarse else index.start_colors)[starts]
    return CandidatePoints(index.positions[number.clamp_min(0)], colors.float() / 255, (number >= 0).float())


@dataclass(frozen=True)
class Comparison:
    """The scan rendered at K poses beside the panorama, both in map axes over the pixels that both see.

    scan, panorama: (K, S, 3) canonical colours over S = H W pixels. weights: (K, S) solid angle, zero where either is missing.
    tables: (K, 3, 256) equalization of the panorama over those pixels, None for labels.
    scan_coverage: (K,) share of the sphere that the scan fills. views: what was rendered.
    """

    scan: Tensor
    panorama: Tensor
    weights: Tensor
    tables: Tensor | None
    scan_coverage: Tensor
    views: SyntheticViews


def compare(
    cloud: RenderCloud, level: PanoramaLevel, rotations: Tensor, positions: Tensor, height: int, is_labels: bool
) -> Comparison:
    """Render the cloud at K poses and turn the panorama into the same axes.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3). Colours are equalized over the pixels that both sides see, so that
    what only one of them shows does not shift the colours of the rest.
    """
    width = 2 * height
    views = render_views(cloud, positions, height, width)
    directions = pixel_directions(height, width, positions.device).view(-1, 3)
    u, v = project(directions @ rotations, level.height, 2 * level.height)
    sampled = sample_bilinear(torch.cat((level.color, level.valid[None])), u, v)
    solid = pixel_solid_angles(height, width, positions.device).expand(-1, width).flatten()
    seen = views.valid.flatten(1) * solid
    weights = seen * (sampled[..., 3] > 0.99)
    scan, panorama, tables = views.color.flatten(1, 2), sampled[..., :3], None
    if not is_labels:
        scan = apply_tables(scan, equalization_tables(scan, weights))
        tables = equalization_tables(panorama, weights)
        panorama = apply_tables(panorama, tables)
    return Comparison(scan, panorama, weights, tables, seen.sum(-1) / solid.sum(), views)


def points_seen_from_poses(cloud: RenderCloud, comparison: Comparison, count: int) -> CandidatePoints:
    """Return `count` points (K, count) seen at the rendered poses, spread evenly over the sphere.

    Their colours are those of the rendered pixels: averages over a pixel, as in the panorama.
    """
    height, width = comparison.views.depth.shape[1:]
    u, v = project(even_directions(count).to(comparison.scan.device), height, width)
    pixel = v.long().clamp(0, height - 1) * width + u.long().clamp(0, width - 1)
    pixel = torch.unique(pixel)
    number = comparison.views.point.flatten(1)[:, pixel]
    solid = pixel_solid_angles(height, width, pixel.device).expand(-1, width).flatten()[pixel]
    weights = (number >= 0) * (solid / solid.mean())
    return CandidatePoints(cloud.positions[number.clamp_min(0)], comparison.scan[:, pixel], weights)
