"""Synthetic views: what the scan looks like from a position, by z-buffered splatting with a validity mask.

Every point covers an angle of about its spacing over its distance, so near surfaces must hide far ones although their points lie
further apart than pixels. Each point is therefore written at the pyramid level whose pixels are as large as its
footprint; a pixel's depth is the smallest over all levels, its colour that of the finest level that saw it. Far away, where
many points share a pixel, only every 2nd to 32nd is drawn, so that a view costs the same for a room and for a floor.

Paper: §3.1 (one synthetic view per translation).
Deviation: the reference implementation writes one pixel per point in order of depth; walls seen from near become a
lattice through which the next room shines, and black pixels count as missing. Here missing is a mask.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from panoloc.core.config import RENDERING
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.render.render_cloud import RenderCloud, ViewParts, drawn_points

RENDER_BATCH = 8  # views rendered at once: memory stays below 200 MB


@dataclass(frozen=True)
class SyntheticViews:
    """Views rendered from B positions, axes parallel to the map's or those of the parts that were drawn.

    color: (B, H, W, C) float32 in 0..1. depth: (B, H, W) float32 metres, inf where nothing was seen. valid: (B, H, W) bool. point:
    (B, H, W) int64, the number of the visible point nearest to each pixel's centre, −1 where no point fell; empty where points were not
    asked for. window: which part of the sphere the images show. map_from_view: (B, 3, 3), the axes.
    """

    color: Tensor
    depth: Tensor
    valid: Tensor
    point: Tensor
    window: SphereWindow
    map_from_view: Tensor


def render_views(
    cloud: RenderCloud, centers: Tensor, wanted: int | ViewParts, with_points: bool = True
) -> SyntheticViews:
    """Render the cloud from each of the centers (B, 3) in metres.

    wanted: rows of images of the whole sphere, in axes parallel to the map's, or parts of it in axes of their own. with_points: also find
    the point that each pixel shows. Memory is about 100 bytes for each point drawn, per view; the caller chooses B.
    """
    parts = ViewParts.of_sphere(wanted, centers) if isinstance(wanted, int) else wanted
    # Pictures have one more channel than colours and a count, and are drawn by tensors.
    if has_kernels_for(centers) and cloud.colors.shape[1] == 4:
        return _compiled_views(cloud, centers, parts, with_points)
    window = parts.window
    num_levels = max(1, int(math.log2(window.rows / 8)) + 1)  # the coarsest has at least 8 rows to a sphere
    shapes = [(len(centers), window.height >> k, window.width >> k) for k in range(num_levels)]
    offsets = np.cumsum([0, *map(math.prod, shapes)]).tolist()
    number, relative, u, v, pixel, spacing = drawn_points(cloud, centers, parts)
    distance = relative.square().sum(0).sqrt()
    cell = _cells_of(pixel, distance, spacing, offsets, window)
    nearest = torch.full((offsets[-1],), math.inf, device=distance.device)
    nearest.scatter_reduce_(0, cell, distance, "amin")
    depth = _compose_depth(_levels(nearest, shapes))
    limit = torch.add(
        RENDERING.slack_spacings * spacing,
        depth.flatten().index_select(0, pixel),
        alpha=1 + RENDERING.slack_share,
    )
    visible = (distance <= limit).nonzero()[:, 0]
    shown = number.index_select(0, visible)
    sums = torch.zeros((offsets[-1], cloud.colors.shape[1]), device=distance.device)
    sums.index_add_(0, cell.index_select(0, visible), cloud.colors.index_select(0, shown))
    color, valid = _compose_color(_levels(sums, shapes))
    if not with_points:
        return SyntheticViews(color, depth, valid, number[:0], window, parts.rotations)
    u, v, pixel = (part.index_select(0, visible) for part in (u, v, pixel))
    # What fills up the last run lies where its last point does.
    number = _central_points(u, v, pixel, shown.clamp_max(len(cloud.positions) - 1), depth.numel())
    return SyntheticViews(color, depth, valid, number.view(depth.shape), window, parts.rotations)


def depths_from(cloud: RenderCloud, centers: Tensor, rows: int) -> Tensor:
    """Return the depths (B, rows, 2 rows), metres, alone of the views that `render_views` renders of the whole sphere."""
    if not has_kernels_for(centers):
        return render_views(cloud, centers, rows, with_points=False).depth
    depth = centers.new_empty((len(centers), rows, 2 * rows))
    _draw(cloud, centers, ViewParts.of_sphere(rows, centers), None, depth, None, None)
    return depth


def _compiled_views(cloud: RenderCloud, centers: Tensor, parts: ViewParts, with_points: bool) -> SyntheticViews:
    """Return what `render_views` returns, by the kernel."""
    shape = len(centers), parts.window.height, parts.window.width
    color, depth = centers.new_empty((*shape, 3)), centers.new_empty(shape)
    valid, point = torch.empty(shape, dtype=torch.bool), torch.empty(shape if with_points else 0, dtype=torch.int64)
    _draw(cloud, centers, parts, color, depth, valid, point if with_points else None)
    return SyntheticViews(color, depth, valid, point, parts.window, parts.rotations)


def _draw(cloud: RenderCloud, centers: Tensor, parts: ViewParts, *found: Tensor | None) -> None:
    """Draw views by the kernel. found: color, depth, valid and point, as of `SyntheticViews`; None for what is not wanted."""
    scan = cloud.colors, cloud.block_centers, cloud.block_radii
    size = len(cloud.block_centers), len(cloud.positions), cloud.spacing
    window = parts.window
    pixels = window.rows, window.first_row, window.first_column, window.height, window.width
    rules = RENDERING.footprint, RENDERING.slack_spacings, RENDERING.slack_share, RENDERING.fill_levels
    views, cones = (len(centers), centers, parts.rotations), (parts.axes, parts.half_angles, len(parts.half_angles))
    call("render_views", *scan, *cloud.block_points, *size, *pixels, *rules, *views, *cones, *found)


def _central_points(u: Tensor, v: Tensor, pixel: Tensor, point: Tensor, num_pixels: int) -> Tensor:
    """Return for each pixel the number of the point nearest to its centre, −1 without any.

    A pixel's colour is an average over the pixel; pairing it with a point to one side would shift every pose to that side.
    """
    off_center = (u - u.floor() - 0.5).square() + (v - v.floor() - 0.5).square()
    none = torch.iinfo(torch.int64).max
    best = torch.full((num_pixels,), none, dtype=torch.int64, device=u.device)
    best.scatter_reduce_(0, pixel, ((off_center * 2**20).long() << 32) | point, "amin")
    return torch.where(best == none, -1, best & 0xFFFFFFFF)


def visible_points(relative: Tensor, spacing: float, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pixel (N,) that each point shows in, and which points (N,) a view sees whose depth (H, W) of the sphere was rendered.

    relative: (N, 3), metres from the view, in its axes. spacing: of the scan, metres.
    """
    pixel = pixels_towards(relative, len(depth))
    limit = depth.flatten()[pixel] * (1 + RENDERING.slack_share) + RENDERING.slack_spacings * spacing
    visible: Tensor = relative.norm(dim=-1) <= limit
    return pixel, visible


def _levels(cells: Tensor, shapes: list[tuple[int, int, int]]) -> list[Tensor]:
    """Return the levels (B, h, w, ...), the finest first, of an array of all their cells."""
    parts = torch.split(cells, [math.prod(shape) for shape in shapes])
    return [part.view(*shape, *cells.shape[1:]) for part, shape in zip(parts, shapes, strict=True)]


def _cells_of(pixel: Tensor, distance: Tensor, spacing: Tensor, offsets: list[int], window: SphereWindow) -> Tensor:
    """Return the flat cell (M,) of each point, which falls into `pixel`, at the level of its footprint.

    offsets: where the cells of each level start in an array of all, and how many there are.
    """
    height, width = window.height, window.width
    # A footprint of exactly one pixel belongs to the finest level in spite of rounding.
    footprint = (0.999 * RENDERING.footprint * window.rows / math.pi) * spacing / distance.clamp_min(1e-6)
    large = (footprint > 1).nonzero()[:, 0]  # few: only near points are larger than a pixel
    coarsest = len(offsets) - 2
    if coarsest == 0 or not len(large):
        return pixel
    level = torch.log2(footprint[large]).ceil_().clamp_(1, coarsest).long()
    fine = pixel[large]
    column, row = fine % width, fine.div(width, rounding_mode="floor")
    view, row = row.div(height, rounding_mode="floor"), row % height
    rows, columns = height >> level, width >> level
    row, column = torch.minimum(row >> level, rows - 1), torch.minimum(column >> level, columns - 1)
    start = torch.tensor(offsets, device=pixel.device)[level]
    cell = pixel.clone()
    cell[large] = start + (view * rows + row) * columns + column
    return cell


def _compose_depth(levels: list[Tensor]) -> Tensor:
    """Return the smallest depth (B, H, W) over all levels (B, h, w)."""
    depth = levels[-1]
    for here in reversed(levels[:-1]):
        depth = torch.minimum(double(depth), here)
    return depth


def _compose_color(levels: list[Tensor]) -> tuple[Tensor, Tensor]:
    """Return the colour (B, H, W, C) of the finest level with a visible point, and where there is one.

    levels: (B, h, w, C + 1), sums of colours and counts.
    """
    color, valid = _cell_colors(levels, len(levels) - 1)
    for k in range(len(levels) - 2, -1, -1):
        mean, seen = _cell_colors(levels, k)
        color, valid = torch.where(seen[..., None], mean, double(color)), seen | double(valid)
    return color, valid


def _cell_colors(levels: list[Tensor], k: int) -> tuple[Tensor, Tensor]:
    """Return the colours (B, h, w, C) of the cells of a level, and which have a point.

    A cell also counts the points written up to `fill_levels` levels below it, so that gaps of a few pixels are filled while
    windows and unscanned corners stay missing.
    """
    here = levels[k]
    for below in range(max(0, k - RENDERING.fill_levels), k):
        here = here + pool(levels[below], k - below)
    return here[..., :-1] / here[..., -1:].clamp_min(1), here[..., -1] > 0


def pool(level: Tensor, halvings: int) -> Tensor:
    """Sum (B, h, w, C) over squares of 2^halvings cells."""
    for _ in range(halvings):
        # Rows, then columns: a sum over two axes at once takes six times as long.
        rows = level[:, ::2] + level[:, 1::2]
        level = rows[:, :, ::2] + rows[:, :, 1::2]
    return level


def double(level: Tensor) -> Tensor:
    """Repeat rows and columns of (B, h, w, ...) twice."""
    return level.repeat_interleave(2, dim=1).repeat_interleave(2, dim=2)


def halve(color: Tensor, valid: Tensor) -> Tensor:
    """Average (B, H, W, 3) over squares of two valid pixels a side."""
    weight = valid[..., None].float()
    return pool(color * weight, 1) / pool(weight, 1).clamp_min(1e-6)
