"""The scan rendered at poses beside the panorama turned into the same axes: what judgement and refinement compare."""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.features.equalization import apply_tables, equalization_tables
from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles, project, sample_bilinear
from panoloc.core.image.pyramid import PanoramaLevel
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import SyntheticViews, render_views


@dataclass(frozen=True)
class Comparison:
    """The scan rendered at K poses beside the panorama, both in map axes over the pixels that both see.

    scan, panorama: (K, S, 3) canonical colours over S = H W pixels. weights: (K, S) solid angle, zero where either is missing.
    tables: (K, 3, 256) equalization of the panorama over those pixels, None for labels.
    views: what was rendered. photo: (K, S) int64, which photo of a session a pixel is compared with, −1 for none; None for a panorama.
    Of photos the pixels are those of the window of `views.parts`, in the axes there.
    """

    scan: Tensor
    panorama: Tensor
    weights: Tensor
    tables: Tensor | None
    views: SyntheticViews
    photo: Tensor | None = None

    def on_sphere(self) -> "Comparison":
        """Return it with pixels of the whole sphere, in the same axes, of which those beyond the part that was compared weigh nothing."""
        window = self.views.window
        if window.is_whole:
            return self
        scan, panorama, weights = (window.on_sphere(each) for each in (self.scan, self.panorama, self.weights))
        photo = None if self.photo is None else window.on_sphere(self.photo, -1)
        return Comparison(scan, panorama, weights, self.tables, self.views.on_sphere(), photo)


def compare(
    cloud: RenderCloud,
    level: PanoramaLevel,
    rotations: Tensor,
    positions: Tensor,
    height: int,
    is_labels: bool,
    with_points: bool = True,
) -> Comparison:
    """Render the cloud at K poses and turn the panorama into the same axes.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3). Colours are equalized over the pixels that both sides see, so that
    what only one of them shows does not shift the colours of the rest. with_points: needed by `points_seen_from_poses`.
    """
    width = 2 * height
    views = render_views(cloud, positions, height, with_points)
    directions = pixel_directions(height, width, positions.device).view(-1, 3)
    u, v = project(directions @ rotations, level.height, 2 * level.height)
    sampled = sample_bilinear(torch.cat((level.color, level.valid[None])), u, v)
    solid = pixel_solid_angles(height, width, positions.device).expand(-1, width).flatten()
    weights = views.valid.flatten(1) * solid * (sampled[..., 3] > 0.99)
    scan, panorama, tables = views.color.flatten(1, 2), sampled[..., :3], None
    if not is_labels:
        scan = apply_tables(scan, equalization_tables(scan, weights))
        tables = equalization_tables(panorama, weights)
        panorama = apply_tables(panorama, tables)
    return Comparison(scan, panorama, weights, tables, views)
