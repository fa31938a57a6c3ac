"""The edges of photos, each as the plane through the lens and the edge.

A straight edge in space, whatever its distance, lies in one plane with the lens. The normal of that plane is the direction in which colours
change fastest across the edge, a unit vector of the rig: the vanishing point of the edge lies at a right angle to it.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST, LineConfig
from panoloc.core.image.level import VALID_SHARE
from panoloc.core.image.photo_window import FINEST_ROWS
from panoloc.core.image.rig_pyramid import RigPyramid, Windows

_SMOOTHING = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


@dataclass(frozen=True)
class Edges:
    """Pixels on edges: directions (E, 3), unit vectors of the rig, and normals (E, 3) of the planes of their edges, either way round.

    length_deg: how long all edges are together, those of which nothing was taken too.
    """

    directions: Tensor
    normals: Tensor
    length_deg: float = 0.0

    @property
    def count(self) -> int:
        """Return E."""
        return len(self.normals)


def edges_of_photos(pyramid: RigPyramid, config: LineConfig) -> Edges:
    """Return the strongest edges in each of equal squares of the photos, thinned to one pixel across; few or none where hardly any are.

    Taken from everywhere: the strongest of all are those of one rug or picture, which may hang askew.
    """
    windows = pyramid.windows(min(FINEST_ROWS // 2, pyramid.finest_rows))
    magnitude, east, north = _gradients(windows)
    valid = windows.valid > 0
    # Where most of a photo is plain, how fast colours change there is noise.
    least = (config.edge_over_noise * magnitude[valid].median()).clamp_min(config.least_gradient)
    ridges = _ridges(magnitude, east, north, windows)
    ridges = ridges * (ridges > least)
    length_deg = int((ridges > 0).sum()) * 180 / windows.rows
    side = max(1, round(math.sqrt(int(valid.sum()) / config.squares)))
    chosen = _strongest(ridges, side, config.edges_in_square)
    directions = windows.directions.flatten(0, 1)[chosen]
    normals = _tangents(directions, east.flatten()[chosen], north.flatten()[chosen])
    turned = pyramid.rotations[windows.image.flatten()[chosen]] @ torch.stack((directions, normals), dim=-1)
    return Edges(turned[..., 0].contiguous(), turned[..., 1].contiguous(), length_deg)


def _strongest(ridges: Tensor, side: int, count: int) -> Tensor:
    """Return the numbers (E,), among all pixels, of the largest of each square of `side` pixels, at most `count` and none that is zero."""
    height, width = ridges.shape
    padded = torch.nn.functional.pad(ridges, (0, -width % side, 0, -height % side))
    squares = padded.unfold(0, side, side).unfold(1, side, side).flatten(2)
    values, inside = squares.topk(min(count, side * side))
    row, column, rank = values.nonzero(as_tuple=True)
    inside = inside[row, column, rank]
    return (row * side + inside // side) * width + column * side + inside % side


def _gradients(windows: Windows) -> tuple[Tensor, Tensor, Tensor]:
    """Return how fast colours change at each pixel (H, W), and the unit direction of it, to the east and north (H, W) of the sphere.

    Of all channels together: the largest eigenvalue of their structure tensor (Di Zenzo 1986), so that edges between equally bright
    colours count.
    """
    share = _smoothed(windows.valid[None])
    smooth = _smoothed(windows.color * windows.valid) / share.clamp_min(1e-6)
    planes = windows.level((smooth + CONTRAST.darkest).log()).planes
    x, y, _ = windows.directions.unbind(-1)
    east, north = planes[3:6] / torch.hypot(x, y).clamp_min(1e-3), planes[6:9]
    first, mixed, second = (east * east).sum(0), (east * north).sum(0), (north * north).sum(0)
    spread = ((first - second).square() / 4 + mixed.square()).sqrt()
    magnitude = ((first + second) / 2 + spread).clamp_min(0).sqrt() * (share[0] > VALID_SHARE)
    angle = torch.atan2(2 * mixed, first - second) / 2
    return magnitude, angle.cos(), angle.sin()


def _ridges(magnitude: Tensor, east: Tensor, north: Tensor, windows: Windows) -> Tensor:
    """Return the magnitude (H, W) where it is the largest across the edge, and zero elsewhere (Canny 1986)."""
    x, y, _ = windows.directions.unbind(-1)
    # Columns run against the azimuth, and are narrower towards the poles; rows run against the elevation.
    columns, rows = -east / torch.hypot(x, y).clamp_min(1e-3), -north
    longest = torch.maximum(columns.abs(), rows.abs()).clamp_min(1e-9)
    column_step, row_step = (columns / longest).round().long(), (rows / longest).round().long()
    height, width = magnitude.shape
    row = torch.arange(height, device=magnitude.device)[:, None]
    column = torch.arange(width, device=magnitude.device)

    def beside(sign: int) -> Tensor:
        """Return the magnitude one pixel across the edge."""
        at_row = (row + sign * row_step).clamp(0, height - 1)
        return magnitude[at_row, (column + sign * column_step).clamp(0, width - 1)]

    return magnitude * ((magnitude >= beside(1)) & (magnitude > beside(-1)))


def _smoothed(planes: Tensor) -> Tensor:
    """Smooth planes (C, H, W) by a binomial kernel of five pixels; beyond the border is nothing."""
    return _smoothed_along(_smoothed_along(planes, 2), 1)


def _smoothed_along(planes: Tensor, axis: int) -> Tensor:
    """Smooth along one axis; by sums of shifted planes, for a convolution of a single channel takes several times as long."""
    smooth, length = _SMOOTHING[2] * planes, planes.shape[axis]
    for shift in (1, 2):
        kept, weight = max(0, length - shift), _SMOOTHING[2 + shift]
        smooth.narrow(axis, 0, kept).add_(planes.narrow(axis, length - kept, kept), alpha=weight)
        smooth.narrow(axis, length - kept, kept).add_(planes.narrow(axis, 0, kept), alpha=weight)
    return smooth


def _tangents(directions: Tensor, east: Tensor, north: Tensor) -> Tensor:
    """Return unit tangents (E, 3) of the sphere at directions (E, 3), from their components to the east and north (E,)."""
    x, y, z = directions.unbind(-1)
    flat = torch.hypot(x, y).clamp_min(1e-6)
    to_east = torch.stack((-y / flat, x / flat, torch.zeros_like(x)), dim=-1)
    to_north = torch.stack((-x * z / flat, -y * z / flat, flat), dim=-1)
    return to_east * east[:, None] + to_north * north[:, None]
