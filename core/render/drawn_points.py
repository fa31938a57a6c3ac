"""Which points of a scan are drawn into views, and where they fall: far away, where many share a pixel, only every 2nd to 32nd.

A photo shows a part of the sphere. Of it alone views are drawn then, in axes in which that part lies at the same pixels for every pose.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import RENDERING
from panoloc.core.geometry.projection import project
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.render.render_cloud import BLOCK, MAX_STRIDE_EXPONENT, RenderCloud


@dataclass(frozen=True)
class ViewParts:
    """The parts of B views that are wanted, in axes of their own.

    rotations: (B, 3, 3) map_from_view. window: of the image in these axes. axes: (B, M, 3), unit directions in the map, and half_angles
    (M,), radians: outside of the cones around them nothing need be drawn.
    """

    rotations: Tensor
    window: SphereWindow
    axes: Tensor
    half_angles: Tensor


@dataclass(frozen=True)
class DrawnPoints:
    """The M points drawn into all views: number (M,), from N on for what fills up the last run; relative (3, M), metres, where each lies
    from its view; u and v (M,), pixel coordinates on the whole sphere; pixel (M,), of its window, over all views; spacing (M,), metres,
    that they are left with."""

    number: Tensor
    relative: Tensor
    u: Tensor
    v: Tensor
    pixel: Tensor
    spacing: Tensor


def drawn_points(cloud: RenderCloud, centers: Tensor, window: SphereWindow, parts: ViewParts | None) -> DrawnPoints:
    """Choose the points of each view. A block is thinned by the largest power of two that leaves a point in every pixel."""
    distance: Tensor = torch.cdist(centers, cloud.block_centers) - cloud.block_radii
    pixel_angle = math.pi / window.rows
    per_point = (distance * (pixel_angle / (RENDERING.footprint * cloud.spacing))).clamp_min(1.0).square()
    exponent = torch.log2(per_point).floor_().clamp_(0, MAX_STRIDE_EXPONENT).to(torch.int8)
    if parts is not None:
        exponent.masked_fill_(~_blocks_within(cloud, centers, parts), -1)
    points, views, places, spacings = [], [], [], []
    for step, blocks in enumerate(cloud.block_points):
        view, block = (exponent == step).nonzero(as_tuple=True)
        place = blocks.index_select(0, block) - centers.index_select(0, view)[..., None]
        if parts is not None:
            place = parts.rotations.transpose(1, 2).index_select(0, view) @ place
        member = torch.arange(0, BLOCK, 1 << step, device=centers.device)
        points.append((block[:, None] * BLOCK + member).flatten())
        views.append(view.repeat_interleave(len(member)))
        places.append(place.transpose(0, 1).flatten(1))
        spacings.append(torch.full((len(points[-1]),), cloud.spacing * math.sqrt(1 << step), device=centers.device))
    number, view, relative, spacing = torch.cat(points), torch.cat(views), torch.cat(places, dim=1), torch.cat(spacings)
    u, v = project(relative.T, window.rows, 2 * window.rows)
    row = v.long().clamp_(0, window.rows - 1) - window.first_row
    column = u.long().clamp_(0, 2 * window.rows - 1) - window.first_column
    pixel = (view * window.height + row) * window.width + column
    if window.is_whole:
        return DrawnPoints(number, relative, u, v, pixel, spacing)
    inside = ((row >= 0) & (row < window.height) & (column >= 0) & (column < window.width)).nonzero()[:, 0]
    number, u, v, pixel, spacing = (part.index_select(0, inside) for part in (number, u, v, pixel, spacing))
    return DrawnPoints(number, relative.index_select(1, inside), u, v, pixel, spacing)


def _blocks_within(cloud: RenderCloud, centers: Tensor, parts: ViewParts) -> Tensor:
    """Tell which blocks (B, blocks) have a part in some cone of each view."""
    towards = cloud.block_centers - centers[:, None]
    distance = towards.norm(dim=-1).clamp_min(1e-6)
    reach = torch.asin((cloud.block_radii / distance).clamp(max=1.0))
    within: Tensor = distance <= cloud.block_radii
    for number, half in enumerate(parts.half_angles.tolist()):
        cosine = (towards @ parts.axes[:, number, :, None])[..., 0] / distance
        within |= torch.acos(cosine.clamp(-1, 1)) <= half + reach
    return within
