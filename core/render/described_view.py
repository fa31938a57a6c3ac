"""Synthetic views as they are described: with the light taken out of their colours, and what each pixel weighs."""

from torch import Tensor

from panoloc.core.features.equalization import equalize
from panoloc.core.features.fine_views import RenderedViews
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import render_views


def views_to_describe(
    cloud: RenderCloud, centers: Tensor, height: int, is_labels: bool
) -> tuple[RenderedViews, Tensor]:
    """Return the views from `centers` (B, 3), of `height` rows, and in which pixels (B, H, W) a point falls."""
    width = 2 * height
    views = render_views(cloud, centers, height)
    weights = views.valid * pixel_solid_angles(height, width, centers.device)
    flat = views.color.flatten(1, 2)
    canonical = flat if is_labels else equalize(flat, weights.flatten(1))
    return RenderedViews(views.color, canonical, views.valid, weights), views.point >= 0
