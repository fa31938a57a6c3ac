"""The points of a scan, ordered and thinned in advance so that any number of views can be rendered of them, and which of them are drawn.

Far away, where many points share a pixel, only every 2nd to 32nd is drawn. A photo shows a part of the sphere: of it alone views are drawn
then, in axes in which that part lies at the same pixels for every pose.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import RENDERING
from panoloc.core.geometry.projection import project
from panoloc.core.geometry.sphere_window import SphereWindow

BLOCK = 64  # neighbouring points that are thinned together


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
    thinned = [blocks[..., :: 1 << k].contiguous() for k in range(BLOCK.bit_length() - 1)]  # down to two points
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


@dataclass(frozen=True)
class ViewParts:
    """The parts of B views that are wanted, in axes of their own.

    rotations: (B, 3, 3) map_from_view. window: of the image in these axes. axes: (B, M, 3), unit directions in the map, and half_angles
    (M,), radians: outside of the cones around them nothing need be drawn; without cones everything is.
    """

    rotations: Tensor
    window: SphereWindow
    axes: Tensor
    half_angles: Tensor

    @staticmethod
    def of_sphere(rows: int, centers: Tensor) -> "ViewParts":
        """Return all of views from centers (B, 3), images of `rows` rows in axes parallel to the map's."""
        rotations = torch.eye(3, device=centers.device).expand(len(centers), 3, 3)
        return ViewParts(rotations, SphereWindow.of_sphere(rows), rotations[:, :0], centers.new_empty(0))


def drawn_points(
    cloud: RenderCloud, centers: Tensor, parts: ViewParts
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Choose the points of each view. A block is thinned by the largest power of two that leaves a point in every pixel.

    Returns of the M points drawn into all views: number (M,), from N on for what fills up the last run; where each lies from its view
    (3, M), metres; u and v (M,), pixel coordinates on the whole sphere; pixel (M,), of its window, over all views; spacing (M,), metres,
    that they are left with.
    """
    window, is_partial = parts.window, len(parts.half_angles) > 0
    distance: Tensor = torch.cdist(centers, cloud.block_centers) - cloud.block_radii
    pixel_angle = math.pi / window.rows
    per_point = (distance * (pixel_angle / (RENDERING.footprint * cloud.spacing))).clamp_min(1.0).square()
    exponent = torch.log2(per_point).floor_().clamp_(0, len(cloud.block_points) - 1).to(torch.int8)
    if is_partial:
        exponent.masked_fill_(~_blocks_within(cloud, centers, parts), -1)
    view, block = (exponent >= 0).nonzero(as_tuple=True)
    stride = 1 << exponent[view, block].long()
    counts = BLOCK // stride
    which = torch.repeat_interleave(counts)
    view, block, stride = view[which], block[which], stride[which]
    member = (torch.arange(len(which), device=which.device) - (counts.cumsum(0) - counts)[which]) * stride
    number, relative = block * BLOCK + member, cloud.block_points[0][block, :, member] - centers[view]
    if is_partial:
        relative = (relative[:, None] @ parts.rotations[view])[:, 0]
    relative, spacing = relative.T.contiguous(), cloud.spacing * stride.sqrt()
    u, v = project(relative.T, window.rows, 2 * window.rows)
    pixel, inside = window.pixels_at(u, v)
    pixel += view * (window.height * window.width)
    if window.is_whole:
        return number, relative, u, v, pixel, spacing
    inside = inside.nonzero()[:, 0]
    number, u, v, pixel, spacing = (part.index_select(0, inside) for part in (number, u, v, pixel, spacing))
    return number, relative.index_select(1, inside), u, v, pixel, spacing


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
