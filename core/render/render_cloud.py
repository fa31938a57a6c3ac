"""The points of a scan, ordered and thinned in advance so that any number of views can be rendered of them."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

BLOCK = 64  # neighbouring points that are thinned together
MAX_STRIDE_EXPONENT = 5


@dataclass(frozen=True)
class RenderCloud:
    """Points ordered along a space-filling curve, so that each run of 64 lies together.

    positions: (N, 3) float32 metres. colors: (64 M, C + 1) of `counted_colors`, C = 3 but for pictures. spacing: metres between points.
    block_centers: (M, 3) and block_radii: (M,), metres, of the runs. block_points: for k = 0..5 every 2^k-th point of each run
    (M, 3, 64 >> k), so that thinned runs are read as they lie in memory.
    """

    positions: Tensor
    colors: Tensor
    spacing: float
    block_centers: Tensor
    block_radii: Tensor
    block_points: tuple[Tensor, ...]


def make_render_cloud(positions: Tensor, colors: Tensor, spacing: float) -> RenderCloud:
    """Prepare ordered points (N, 3) and their colours (N, 3) for rendering."""
    missing = -len(positions) % BLOCK
    padded = torch.cat((positions, positions[-1:].expand(missing, 3))) if missing else positions
    blocks = padded.view(-1, BLOCK, 3).transpose(1, 2).contiguous()
    centers = blocks.mean(2)
    radii = (blocks - centers[..., None]).square().sum(1).amax(1).sqrt()
    thinned = [blocks[..., :: 1 << k].contiguous() for k in range(MAX_STRIDE_EXPONENT + 1)]
    return RenderCloud(positions, counted_colors(colors), spacing, centers, radii, tuple(thinned))


def counted_colors(colors: Tensor) -> Tensor:
    """Return colours (64 M, C + 1) for a `RenderCloud` of colours (N, C).

    The last number counts points when colours are summed up: 1, and 0 for what fills up the last run.
    """
    counted = torch.cat((colors, torch.ones_like(colors[:, :1])), dim=1)
    return torch.nn.functional.pad(counted, (0, 0, 0, -len(colors) % BLOCK))


def point_spacing(positions: Tensor) -> float:
    """Estimate the spacing in metres of points (N, 3) that sample surfaces, from how many 10 cm cells they occupy."""
    cells = torch.floor(positions * 10).to(torch.int64)
    cells -= cells.amin(0)
    extent = cells.amax(0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    occupied = len(torch.unique(keys))
    # A plane at a random angle crosses about 1.5 cells per cell area.
    return math.sqrt(0.01 * occupied / 1.5 / max(len(positions), 1))
