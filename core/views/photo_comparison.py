"""The scan rendered at poses of a rig beside what its photos show there.

A rendered pixel is a point at a known depth, so it is looked up where each photo, from a centre of its own, would show it: parallax is
undone by the scan itself.
"""

import math

import torch
from torch import Tensor

from core.geometry.projection import pixel_directions, pixel_solid_angles
from core.light.color_equalization import equalize_where
from core.panorama.photo_atlas import PhotoAtlas
from core.panorama.photo_level import PhotoLevel, PhotoWindows
from core.views.comparison import Comparison
from core.views.render_cloud import RenderCloud
from core.views.synthetic_view import SyntheticViews, ViewCones, render_views

_NEAR_M = 1.0  # what a photo shows is hardly nearer; parallax widens what must be drawn by no more


def compare_photos(
    cloud: RenderCloud,
    atlas: PhotoAtlas,
    rotations: Tensor,
    positions: Tensor,
    height: int,
    is_labels: bool,
    with_points: bool = True,
) -> Comparison:
    """Render the cloud at K poses of the rig, rotations (K, 3, 3) and positions (K, 3), and look up what the photos show.

    Where several photos show a pixel, it is compared with the one whose middle is nearest. Equalized over what both sides see.
    """
    width = 2 * height
    cones = view_cones(atlas, rotations)
    views = render_views(cloud, positions, height, width, with_points, cones)
    seen, photo = _look_up(atlas, views, rotations, height, cones.half_angles)
    solid = pixel_solid_angles(height, width, positions.device).expand(-1, width).flatten()
    weights = views.valid.flatten(1) * solid * (photo >= 0)
    scan, tables = views.color.flatten(1, 2), None
    if not is_labels:
        scan, _ = equalize_where(scan, weights, views.valid.flatten(1))
        seen, tables = equalize_where(seen, weights, photo >= 0)
    return Comparison(scan, seen, weights, tables, views, photo)


def view_cones(atlas: PhotoAtlas, rotations: Tensor) -> ViewCones:
    """Return the cones that the photos show from K poses of the rig (K, 3, 3), seen from the middle of the rig."""
    parallax = torch.asin((atlas.centers.norm(dim=-1) / _NEAR_M).clamp(max=1.0))
    half_angles = (atlas.cones + parallax).clamp(max=math.pi)
    return ViewCones(torch.einsum("kab,mb->kma", rotations, atlas.rotations[:, :, 0]), half_angles)


def _look_up(
    atlas: PhotoAtlas, views: SyntheticViews, rotations: Tensor, height: int, half_angles: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the colours (K, S, 3) that photos show at the rendered pixels, and the number of the photo (K, S), −1 for none."""
    windows = atlas.windows(height)
    level = _colors_alone(windows)
    directions = pixel_directions(height, 2 * height, rotations.device).view(-1, 3)
    depth = views.depth.flatten(1)
    count, size = depth.shape
    color = torch.zeros((count * size, 3), device=depth.device)
    photo = torch.full((count * size,), -1, dtype=torch.int64, device=depth.device)
    central = torch.full((count * size,), -2.0, device=depth.device)
    for number in range(len(atlas)):
        axes = rotations @ atlas.rotations[number, :, 0]
        near = (axes @ directions.T >= math.cos(float(half_angles[number]))) & views.valid.flatten(1)
        pose, pixel = near.nonzero(as_tuple=True)
        in_map = directions[pixel] * depth[pose, pixel, None]
        in_rig = torch.einsum("nab,na->nb", rotations[pose], in_map)
        x, y, z = ((in_rig - atlas.centers[number]) @ atlas.rotations[number]).unbind(-1)
        flat = torch.hypot(x, y)
        which = None if len(atlas) == 1 else torch.full_like(pixel, number)[None]
        sampled = level.sample(torch.atan2(y, x)[None], torch.atan2(z, flat)[None], which)[0]
        ahead = x / torch.hypot(flat, z).clamp_min(1e-6)
        at = pose * size + pixel
        better = (sampled[3] > 0.99) & (ahead > central[at])
        at = at[better]
        color[at], central[at], photo[at] = sampled[:3, better].T, ahead[better], number
    return color.view(count, size, 3), photo.view(count, size)


def _colors_alone(windows: PhotoWindows) -> PhotoLevel:
    """Return the windows as a level without derivatives: colour and validity."""
    planes = torch.cat((windows.color, windows.valid[None]))
    places = windows.tops, windows.first_rows, windows.first_columns, windows.heights, windows.widths
    return PhotoLevel(planes, windows.rows, *places)
