"""The points that candidates are refined on: those seen from the start while poses are rough, those seen from the pose later.

Points behind a wall must not vote (docs/method.md): both kinds come out of a z-buffer.
"""

import torch
from torch import Tensor

from panoloc.core.config import RefinementConfig
from panoloc.core.features.equalization import equalize
from panoloc.core.features.local_contrast import mixed_with_contrast
from panoloc.core.geometry.projection import pixel_solid_angles, pixels_towards
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.map.map_index import MapIndex
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import RENDER_BATCH, SyntheticViews, halve, render_views


def points_seen_from_starts(
    index: MapIndex, starts: Tensor, height: int, count: int, contrast_share: float
) -> tuple[CandidatePoints, CandidatePoints]:
    """Return `count` points (K, count) that each of the starts numbered `starts` (K,) sees, with their canonical colours.

    First with the colours of a view of half the `height` in rows, then with those of a view of `height` rows.
    """
    cloud = index.render_cloud
    directions = even_directions(count).to(starts.device)
    numbers, coarse, fine = [], [], []
    for part in torch.split(starts, RENDER_BATCH):
        views = render_views(cloud, index.starts[part], height)
        canonical = _canonical_view(views, index.labels is not None, contrast_share)
        pixel = pixels_towards(directions, height)
        numbers.append(views.point.flatten(1)[:, pixel])
        fine.append(canonical.flatten(1, 2)[:, pixel])
        halved = halve(canonical, views.valid)
        coarse.append(halved.flatten(1, 2)[:, pixels_towards(directions, height // 2)])
    number = torch.cat(numbers)
    positions, weights = cloud.positions[number.clamp_min(0)], (number >= 0).float()
    return (
        CandidatePoints(positions, torch.cat(coarse), weights),
        CandidatePoints(positions, torch.cat(fine), weights),
    )


def _canonical_view(views: SyntheticViews, is_labels: bool, contrast_share: float) -> Tensor:
    """Return the canonical colours (B, H, W, 3) of what was rendered: equalized and mixed with contrast, or label codes."""
    if is_labels:
        return views.color
    _, height, width, _ = views.color.shape
    valid = views.valid.float()
    weights = valid * pixel_solid_angles(height, width, valid.device)
    equalized = equalize(views.color.flatten(1, 2), weights.flatten(1)).view(views.color.shape)
    return mixed_with_contrast(equalized, views.color, valid, contrast_share)


def points_seen_from_poses(
    cloud: RenderCloud,
    comparison: Comparison,
    count: int,
    contrast_share: float,
    pixel_weights: Tensor | None = None,
) -> CandidatePoints:
    """Return `count` points (K, count) seen at the rendered poses, spread evenly over the sphere.

    Their colours are those of the rendered pixels, averages over a pixel as in the panorama, mixed with contrast. pixel_weights:
    (K, S), further weights of the rendered pixels, such as `unchanged_share`.
    """
    height, width = comparison.views.depth.shape[1:]
    pixel = torch.unique(pixels_towards(even_directions(count).to(comparison.scan.device), height))
    number = comparison.views.point.flatten(1)[:, pixel]
    solid = pixel_solid_angles(height, width, pixel.device).expand(-1, width).flatten()[pixel]
    weights = (number >= 0) * (solid / solid.mean())
    if pixel_weights is not None:
        weights = weights * pixel_weights[:, pixel]
    colors = comparison.scan
    if comparison.tables is not None:
        views = comparison.views
        shaped = colors.view(views.color.shape)
        colors = mixed_with_contrast(shaped, views.color, views.valid.float(), contrast_share).flatten(1, 2)
    return CandidatePoints(cloud.positions[number.clamp_min(0)], colors[:, pixel], weights)


def unchanged_share(comparison: Comparison, config: RefinementConfig) -> Tensor:
    """Return (K, S) in 0..1 how well each pixel's surroundings agree.

    As weights they take the vote from regions that have changed since the scan, the role of the score maps in the paper's Eq. 5. That
    frees poses that furniture holds back, but it also mutes edges, which the last millimetres need.
    """
    window = comparison.views.window
    distance_square = (comparison.scan - comparison.panorama).square().sum(-1) / config.unchanged_difference**2
    share = (1 / (1 + distance_square)).view(-1, 1, window.height, window.width)
    reach = max(1, window.rows // config.unchanged_regions)
    sides = "circular" if window.is_round else "replicate"
    padded = torch.nn.functional.pad(share, (reach, reach, 0, 0), mode=sides)
    padded = torch.nn.functional.pad(padded, (0, 0, reach, reach), mode="replicate")
    smooth = torch.nn.functional.avg_pool2d(padded, 2 * reach + 1, stride=1)
    return smooth.flatten(1).square()
