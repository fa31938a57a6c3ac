"""Synthetic views: what the scan looks like from a position, by z-buffered splatting with a validity mask.

Every point covers an angle of about its spacing over its distance, so near surfaces must hide far ones although their points lie
further apart than pixels. Each point is therefore written at the pyramid level whose pixels are as large as its
footprint; a pixel's depth is the smallest over all levels, its colour that of the finest level that saw it.

Paper: §3.1 (one synthetic view per translation).
Deviation: the reference implementation writes one pixel per point in order of depth; walls seen from near become a
lattice through which the next room shines, and black pixels count as missing. Here missing is a mask.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from core.projection import project

_FOOTPRINT = 1.5  # pixel size over point spacing at which a random sampling of a surface leaves few holes
_SLACK_SPACINGS = 4.0  # depth range of one surface inside a pixel seen at a slant, in point spacings
_SLACK_SHARE = 0.02
_FILL_LEVELS = 2  # holes up to 4 pixels are filled from their surroundings


@dataclass(frozen=True)
class SyntheticViews:
    """Views rendered from B positions, axes parallel to the map's.

    color: (B, H, W, 3) float32 in 0..1. depth: (B, H, W) float32 metres, inf where nothing was seen.
    valid: (B, H, W) bool. point: (B, H, W) int64, the number of a visible point in each pixel, −1 where no point fell.
    visible: (B, N) bool, which points are seen from each position.
    """

    color: Tensor
    depth: Tensor
    valid: Tensor
    point: Tensor
    visible: Tensor


def point_spacing(positions: Tensor) -> float:
    """Estimate the spacing in metres of points (N, 3) that sample surfaces, from how many 10 cm cells they occupy."""
    cells = torch.floor(positions * 10).to(torch.int64)
    cells -= cells.amin(0)
    extent = cells.amax(0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    occupied = len(torch.unique(keys))
    # A plane at a random angle crosses about 1.5 cells per cell area.
    return math.sqrt(0.01 * occupied / 1.5 / max(len(positions), 1))


def num_levels(height: int) -> int:
    """Return how many halvings of an image of `height` rows keep at least 8 rows, plus one."""
    return max(1, int(math.log2(height / 8)) + 1)


def render_views(
    positions: Tensor, colors: Tensor, centers: Tensor, spacing: float, height: int, width: int
) -> SyntheticViews:
    """Render the points from each centre.

    positions: (N, 3) float32 metres. colors: (N, 3) float32 in 0..1. centers: (B, 3) metres. spacing: metres between points.
    Memory is about 100 bytes x B x N; the caller chooses B.
    """
    batch, levels = len(centers), num_levels(height)
    relative = positions[None] - centers[:, None]
    distance = relative.norm(dim=-1)
    u, v = project(relative, height, width)
    cell, offsets, size = _cells_of(u, v, distance, spacing, batch, height, width, levels)
    nearest = torch.full((size,), math.inf, device=positions.device)
    nearest.scatter_reduce_(0, cell.flatten(), distance.flatten(), "amin")
    depth = _compose_depth(nearest, offsets, batch, height, width)
    row = v.long().clamp_(0, height - 1)
    column = u.long().clamp_(0, width - 1)
    pixel = (torch.arange(batch, device=u.device)[:, None] * height + row) * width + column
    front = depth.flatten()[pixel]
    visible = distance <= front * (1 + _SLACK_SHARE) + _SLACK_SPACINGS * spacing
    sums = torch.zeros((size, 4), device=positions.device)
    batch_of, point_of = visible.nonzero(as_tuple=True)
    values = torch.cat((colors[point_of], torch.ones_like(colors[point_of][:, :1])), dim=-1)
    sums.index_add_(0, cell[batch_of, point_of], values)
    color, valid = _compose_color(sums, offsets, batch, height, width)
    point = torch.full((batch * height * width,), -1, dtype=torch.int64, device=positions.device)
    # The highest number wins: arbitrary, but the same on every device and in every run.
    point.scatter_reduce_(0, pixel[batch_of, point_of], point_of, "amax")
    return SyntheticViews(color, depth, valid, point.view(batch, height, width), visible)


def _cells_of(
    u: Tensor, v: Tensor, distance: Tensor, spacing: float, batch: int, height: int, width: int, levels: int
) -> tuple[Tensor, list[int], int]:
    """Return the flat cell (B, N) of each point at the level of its footprint, where each level starts, and the total size."""
    footprint = _FOOTPRINT * spacing / distance.clamp_min(1e-6) * (height / math.pi)
    level = torch.log2(footprint.clamp_min(1.0)).ceil_().clamp_(0, levels - 1).long()
    heights = [height >> k for k in range(levels)]
    widths = [width >> k for k in range(levels)]
    offsets, size = [], 0
    for h, w in zip(heights, widths, strict=True):
        offsets.append(size)
        size += batch * h * w
    rows = torch.tensor(heights, device=u.device)[level]
    columns = torch.tensor(widths, device=u.device)[level]
    row = torch.minimum((v * (rows / height)).long(), rows - 1).clamp_min_(0)
    column = torch.minimum((u * (columns / width)).long(), columns - 1).clamp_min_(0)
    start = torch.tensor(offsets, device=u.device)[level]
    index = torch.arange(batch, device=u.device)[:, None]
    return start + (index * rows + row) * columns + column, offsets, size


def _compose_depth(nearest: Tensor, offsets: list[int], batch: int, height: int, width: int) -> Tensor:
    """Return the smallest depth (B, H, W) over all levels."""
    depth: Tensor | None = None
    for k in range(len(offsets) - 1, -1, -1):
        here = nearest[offsets[k] : offsets[k] + batch * (height >> k) * (width >> k)].view(
            batch, height >> k, width >> k
        )
        depth = here if depth is None else torch.minimum(_double(depth), here)
    assert depth is not None
    return depth


def _compose_color(sums: Tensor, offsets: list[int], batch: int, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Return the colour (B, H, W, 3) of the finest level with a visible point, and where there is one.

    A cell also counts the points written up to `_FILL_LEVELS` levels below it, so that gaps of a few pixels are filled while
    windows and unscanned corners stay missing.
    """
    own = []
    for k, offset in enumerate(offsets):
        h, w = height >> k, width >> k
        own.append(sums[offset : offset + batch * h * w].view(batch, h, w, 4))
    color: Tensor | None = None
    valid: Tensor | None = None
    for k in range(len(own) - 1, -1, -1):
        here = own[k]
        for below in range(max(0, k - _FILL_LEVELS), k):
            here = here + _pool(own[below], k - below)
        seen = here[..., 3] > 0
        mean = here[..., :3] / here[..., 3:].clamp_min(1)
        if color is None or valid is None:
            color, valid = mean, seen
        else:
            color = torch.where(seen[..., None], mean, _double(color))
            valid = seen | _double(valid)
    assert color is not None
    assert valid is not None
    return color, valid


def _pool(level: Tensor, halvings: int) -> Tensor:
    """Sum (B, h, w, C) over squares of 2^halvings cells."""
    batch, h, w, channels = level.shape
    side = 1 << halvings
    return level.view(batch, h // side, side, w // side, side, channels).sum((2, 4))


def _double(level: Tensor) -> Tensor:
    """Repeat rows and columns of (B, h, w, ...) twice."""
    return level.repeat_interleave(2, dim=1).repeat_interleave(2, dim=2)
