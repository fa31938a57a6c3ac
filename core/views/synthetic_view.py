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

import torch
from torch import Tensor

from core.config import RENDERING
from core.geometry.projection import project
from core.views.render_cloud import BLOCK, MAX_STRIDE_EXPONENT, RenderCloud

RENDER_BATCH = 8  # views rendered at once: memory stays below 200 MB


@dataclass(frozen=True)
class SyntheticViews:
    """Views rendered from B positions, axes parallel to the map's.

    color: (B, H, W, C) float32 in 0..1. depth: (B, H, W) float32 metres, inf where nothing was seen.
    valid: (B, H, W) bool. point: (B, H, W) int64, the number of the visible point
    nearest to each pixel's centre, −1 where no point fell; empty where points were not asked for.
    """

    color: Tensor
    depth: Tensor
    valid: Tensor
    point: Tensor


def num_levels(height: int) -> int:
    """Return how many halvings of an image of `height` rows keep at least 8 rows, plus one."""
    return max(1, int(math.log2(height / 8)) + 1)


@dataclass(frozen=True)
class ViewCones:
    """The parts of B views that are wanted: axes (B, M, 3), unit directions in the map; half_angles (M,), radians, around them."""

    axes: Tensor
    half_angles: Tensor


def render_views(
    cloud: RenderCloud,
    centers: Tensor,
    height: int,
    width: int,
    with_points: bool = True,
    cones: ViewCones | None = None,
) -> SyntheticViews:
    """Render the cloud from each of the centers (B, 3) in metres, in images of `height` x `width` pixels.

    with_points: also find the point that each pixel shows. cones: outside of them nothing need be drawn; None: all is.
    Memory is about 100 bytes for each point drawn, per view; the caller chooses B.
    """
    batch, levels = len(centers), num_levels(height)
    point, view, relative, spacing = _drawn_points(cloud, centers, math.pi / height, cones)
    distance = relative.square().sum(0).sqrt()
    u, v = project(relative.T, height, width)
    pixel = _pixel_of(u, v, view, height, width)
    offsets, size = _level_offsets(batch, height, width, levels)
    cell = _cells_of(pixel, distance, spacing, offsets, height, width)
    nearest = torch.full((size,), math.inf, device=relative.device)
    nearest.scatter_reduce_(0, cell, distance, "amin")
    depth = _compose_depth(nearest, offsets, batch, height, width)
    limit = torch.add(
        RENDERING.slack_spacings * spacing, depth.flatten().index_select(0, pixel), alpha=1 + RENDERING.slack_share
    )
    visible = (distance <= limit).nonzero()[:, 0]
    shown = point.index_select(0, visible)
    sums = torch.zeros((size, cloud.colors.shape[1]), device=relative.device)
    sums.index_add_(0, cell.index_select(0, visible), cloud.colors.index_select(0, shown))
    color, valid = _compose_color(sums, offsets, batch, height, width)
    if not with_points:
        return SyntheticViews(color, depth, valid, point[:0])
    u, v, pixel = (part.index_select(0, visible) for part in (u, v, pixel))
    # What fills up the last run lies where its last point does.
    number = _central_points(u, v, pixel, shown.clamp_max(len(cloud.positions) - 1), batch * height * width)
    return SyntheticViews(color, depth, valid, number.view(batch, height, width))


def _central_points(u: Tensor, v: Tensor, pixel: Tensor, point: Tensor, num_pixels: int) -> Tensor:
    """Return for each pixel the number of the point nearest to its centre, −1 without any.

    A pixel's colour is an average over the pixel; pairing it with a point to one side would shift every pose to that side.
    """
    off_center = (u - u.floor() - 0.5).square() + (v - v.floor() - 0.5).square()
    none = torch.iinfo(torch.int64).max
    best = torch.full((num_pixels,), none, dtype=torch.int64, device=u.device)
    best.scatter_reduce_(0, pixel, ((off_center * 2**20).long() << 32) | point, "amin")
    return torch.where(best == none, -1, best & 0xFFFFFFFF)


def visible_points(positions: Tensor, spacing: float, center: Tensor, depth: Tensor) -> Tensor:
    """Return which points (N, 3) of a scan with this spacing a camera at `center` (3,) sees, given the rendered depth (H, W) there."""
    height, width = depth.shape
    relative = positions - center
    u, v = project(relative, height, width)
    front = depth.flatten()[_pixel_of(u, v, torch.zeros_like(u, dtype=torch.int64), height, width)]
    limit = front * (1 + RENDERING.slack_share) + RENDERING.slack_spacings * spacing
    visible: Tensor = relative.norm(dim=-1) <= limit
    return visible


def _drawn_points(
    cloud: RenderCloud, centers: Tensor, pixel_angle: float, cones: ViewCones | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Choose the points of each view.

    Returns their numbers (M,), from N on for what fills up the last run; the view of each (M,); where they lie from it (3, M) in metres;
    and the spacing (M,) they are left with. A block is thinned by the largest power of two that leaves a point in every pixel.
    """
    distance: Tensor = torch.cdist(centers, cloud.block_centers) - cloud.block_radii
    per_point = (distance * (pixel_angle / (RENDERING.footprint * cloud.spacing))).clamp_min(1.0).square()
    exponent = torch.log2(per_point).floor_().clamp_(0, MAX_STRIDE_EXPONENT).to(torch.int8)
    if cones is not None:
        exponent.masked_fill_(~_blocks_within(cloud, centers, cones), -1)
    points, views, places, spacings = [], [], [], []
    for step, blocks in enumerate(cloud.block_points):
        view, block = (exponent == step).nonzero(as_tuple=True)
        place = blocks.index_select(0, block) - centers.index_select(0, view)[..., None]
        member = torch.arange(0, BLOCK, 1 << step, device=centers.device)
        points.append((block[:, None] * BLOCK + member).flatten())
        views.append(view.repeat_interleave(len(member)))
        places.append(place.transpose(0, 1).flatten(1))
        spacings.append(torch.full((len(points[-1]),), cloud.spacing * math.sqrt(1 << step), device=centers.device))
    return torch.cat(points), torch.cat(views), torch.cat(places, dim=1), torch.cat(spacings)


def _blocks_within(cloud: RenderCloud, centers: Tensor, cones: ViewCones) -> Tensor:
    """Tell which blocks (B, blocks) have a part in some cone of each view."""
    towards = cloud.block_centers - centers[:, None]
    distance = towards.norm(dim=-1).clamp_min(1e-6)
    reach = torch.asin((cloud.block_radii / distance).clamp(max=1.0))
    within: Tensor = distance <= cloud.block_radii
    for number, half in enumerate(cones.half_angles.tolist()):
        cosine = (towards @ cones.axes[:, number, :, None])[..., 0] / distance
        within |= torch.acos(cosine.clamp(-1, 1)) <= half + reach
    return within


def _pixel_of(u: Tensor, v: Tensor, view: Tensor, height: int, width: int) -> Tensor:
    """Return flat pixel numbers over all views."""
    row = v.long().clamp_(0, height - 1)
    column = u.long().clamp_(0, width - 1)
    return (view * height + row) * width + column


def _level_offsets(batch: int, height: int, width: int, levels: int) -> tuple[list[int], int]:
    """Return where the cells of each level start in an array of all cells, and how many there are."""
    offsets, size = [], 0
    for k in range(levels):
        offsets.append(size)
        size += batch * (height >> k) * (width >> k)
    return offsets, size


def _cells_of(pixel: Tensor, distance: Tensor, spacing: Tensor, offsets: list[int], height: int, width: int) -> Tensor:
    """Return the flat cell (M,) of each point, which falls into `pixel`, at the level of its footprint."""
    # A footprint of exactly one pixel belongs to the finest level in spite of rounding.
    footprint = (0.999 * RENDERING.footprint * height / math.pi) * spacing / distance.clamp_min(1e-6)
    large = (footprint > 1).nonzero()[:, 0]  # few: only near points are larger than a pixel
    level = torch.log2(footprint[large]).ceil_().clamp_(1, max(1, len(offsets) - 1)).long()
    if len(offsets) == 1 or not len(large):
        return pixel
    fine = pixel[large]
    column, row = fine % width, fine.div(width, rounding_mode="floor")
    view, row = row.div(height, rounding_mode="floor"), row % height
    rows, columns = height >> level, width >> level
    row, column = torch.minimum(row >> level, rows - 1), torch.minimum(column >> level, columns - 1)
    start = torch.tensor(offsets, device=pixel.device)[level]
    cell = pixel.clone()
    cell[large] = start + (view * rows + row) * columns + column
    return cell


def _compose_depth(nearest: Tensor, offsets: list[int], batch: int, height: int, width: int) -> Tensor:
    """Return the smallest depth (B, H, W) over all levels."""
    depth: Tensor | None = None
    for k in range(len(offsets) - 1, -1, -1):
        here = nearest[offsets[k] : offsets[k] + batch * (height >> k) * (width >> k)].view(
            batch, height >> k, width >> k
        )
        depth = here if depth is None else torch.minimum(double(depth), here)
    assert depth is not None
    return depth


def _compose_color(sums: Tensor, offsets: list[int], batch: int, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Return the colour (B, H, W, C) of the finest level with a visible point, and where there is one.

    A cell also counts the points written up to `fill_levels` levels below it, so that gaps of a few pixels are filled while
    windows and unscanned corners stay missing.
    """
    own = []
    for k, offset in enumerate(offsets):
        h, w = height >> k, width >> k
        own.append(sums[offset : offset + batch * h * w].view(batch, h, w, -1))
    color: Tensor | None = None
    valid: Tensor | None = None
    for k in range(len(own) - 1, -1, -1):
        here = own[k]
        for below in range(max(0, k - RENDERING.fill_levels), k):
            here = here + pool(own[below], k - below)
        seen = here[..., -1] > 0
        mean = here[..., :-1] / here[..., -1:].clamp_min(1)
        if color is None or valid is None:
            color, valid = mean, seen
        else:
            color = torch.where(seen[..., None], mean, double(color))
            valid = seen | double(valid)
    assert color is not None
    assert valid is not None
    return color, valid


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
