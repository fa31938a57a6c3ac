"""What changed: the panorama and the scan compared at the found pose.

Paper: §3.2, Eq. 2 and 3 score every patch by its best match in any view, before the pose is known. Once it is known, every
pixel can be compared with the very point that it should show.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.config import CONTRAST, ChangeConfig
from panoloc.core.geometry.projection import pixel_directions, project, sample_bilinear, wrap_border
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import visible_points


@dataclass(frozen=True)
class ChangeMaps:
    """Scores in 0..1 (1 = as scanned) and the shares that changed.

    score_map_2d: gives (H, W) float32 in the panorama's own pixels, NaN where the scan shows nothing. point_scores: gives (n,) float32 of
    the rendered cloud's points, NaN for points that the camera does not see. Fractions are of solid angle and of seen points.
    """

    score_map_2d: Callable[[], NDArray[np.float32]]
    point_scores: Callable[[], NDArray[np.float32]]
    panorama_changed_fraction: float
    map_changed_fraction: float


def change_maps(
    comparison: Comparison, cloud: RenderCloud, rotation: Tensor, position: Tensor, config: ChangeConfig
) -> ChangeMaps:
    """Score pixels and points at one pose: rotation (3, 3) map_from_camera, position (3,); the comparison holds this pose alone."""
    scores, weights = _pixel_scores(comparison, config), comparison.weights[0]
    changed = (weights * (scores < 0.5)).sum() / weights.sum().clamp_min(1e-9)
    # From here on pixels are those of the whole sphere: points lie anywhere, and those beyond the window have no score.
    window, map_from_view = comparison.views.window, comparison.views.map_from_view[0]
    height, width = window.rows, 2 * window.rows
    planes = scores, weights > 0, comparison.views.depth.flatten()
    scores, seen, depth = (window.on_sphere(each[None]).view(height, width) for each in planes)
    in_view = torch.where(seen, scores, torch.nan)
    # Every k-th point along the curve is an even sample of the scan, enough for a fraction.
    sample = cloud.positions[:: max(1, len(cloud.positions) // config.sampled_points)]
    points = _point_scores(in_view, depth, (sample - position) @ map_from_view, cloud.spacing)
    known = ~points.isnan()
    changed_points = (points[known] < 0.5).float().mean() if bool(known.any()) else torch.zeros(())

    def score_map_2d() -> NDArray[np.float32]:
        """Return the scores (H, W) of all pixels, turned from the view to the camera."""
        directions = pixel_directions(height, width, rotation.device) @ (rotation.T @ map_from_view)
        u, v = project(directions, height, width)
        share = sample_bilinear(torch.stack((scores * seen, seen.float())), u, v)
        in_camera = torch.where(share[..., 1] > 0.5, share[..., 0] / share[..., 1].clamp_min(1e-6), torch.nan)
        return in_camera.cpu().numpy()

    def point_scores() -> NDArray[np.float32]:
        """Return the scores (n,) of all points of the rendered cloud."""
        return _point_scores(in_view, depth, (cloud.positions - position) @ map_from_view, cloud.spacing).cpu().numpy()

    return ChangeMaps(score_map_2d, point_scores, float(changed), float(changed_points))


def _pixel_scores(comparison: Comparison, config: ChangeConfig) -> Tensor:
    """Return a score per pixel (S,) from canonical colours after a last fit of light, forgiving shifts of one pixel."""
    scan, panorama, weights = comparison.scan, comparison.seen, comparison.weights
    for _ in range(3):
        gain, offset = fit_gain_offset(panorama, scan, weights, config.most_gain)
        fitted = panorama * gain[:, None] + offset[:, None]
        distance = (fitted - scan).norm(dim=-1) / config.half_score_difference
        weights = comparison.weights / (1 + distance.square()).square()
    height, width = comparison.views.depth.shape[1:]
    shape = (3, height, width)
    sharp = _nearest_distance(fitted[0].T.reshape(shape), scan[0].T.reshape(shape)) / config.half_score_difference
    score = 1 / (1 + sharp.square())
    # Changes are objects, not pixels: a median-like smoothing removes single outliers at edges.
    padded = wrap_border(score[None])
    blurred = torch.nn.functional.avg_pool2d(padded, 3, stride=1)[0]
    return blurred.flatten()


def _nearest_distance(moving: Tensor, fixed: Tensor) -> Tensor:
    """Return the smallest colour distance (H, W) of each pixel of `fixed` (3, H, W) to the 3 x 3 pixels around it in `moving`."""
    padded = wrap_border(moving)
    height, width = fixed.shape[1:]
    best = torch.full((height, width), torch.inf, device=fixed.device)
    for row in range(3):
        for column in range(3):
            shifted = padded[:, row : row + height, column : column + width]
            best = torch.minimum(best, (shifted - fixed).square().sum(0))
    return best.sqrt()


def _point_scores(in_view: Tensor, depth: Tensor, relative: Tensor, spacing: float) -> Tensor:
    """Return the score of the pixel of `in_view` (H, W) that each point (n, 3), in metres from the view and in its axes, projects to.

    (n,), NaN for points hidden behind `depth`.
    """
    pixel, visible = visible_points(relative, spacing, depth)
    return torch.where(visible, in_view.flatten()[pixel], torch.nan)


def fit_gain_offset(source: Tensor, target: Tensor, weights: Tensor, most_gain: float) -> tuple[Tensor, Tensor]:
    """Return gain and offset (K, 3) that bring `source` (K, N, 3) nearest to `target`, weighted (K, N); gains stay within `most_gain`
    and one over it.

    A small prior towards gain 1 keeps the fit defined where there is no contrast.
    """
    # One plane per channel: sums over these are several times faster.
    source, target = source.transpose(1, 2).contiguous(), target.transpose(1, 2).contiguous()
    share = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-9))[:, None]
    mean_source, mean_target = (source * share).sum(-1), (target * share).sum(-1)
    centered = source - mean_source[..., None]
    weighted = centered * share
    variance, covariance = (weighted * centered).sum(-1), (weighted * target).sum(-1)
    gain = ((covariance + CONTRAST.noise) / (variance + CONTRAST.noise)).clamp(1 / most_gain, most_gain)
    return gain, mean_target - gain * mean_source
