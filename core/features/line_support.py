"""The edges of photos, and how well they agree with lines that run along three axes at right angles, for any turn of the camera.

A straight edge in space, whatever its distance, lies in one plane with the lens. The normal of that plane is the direction in which colours
change fastest across the edge, a unit vector of the rig: the vanishing point of the edge lies at a right angle to it.

Rooms are built along three axes, and so is most of what stands in them. Each edge either runs towards the vanishing point of an axis, or in
any direction: the model of Coughlan and Yuille (*Manhattan World*, ICCV 1999), of which the logarithm of the likelihood ratio is taken.
Axes are looked up one by one in a map of the sphere, for an edge seldom agrees with two: so any number of turns costs three look-ups each.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST, LineConfig
from panoloc.core.geometry.projection import (
    LEAST_SINE,
    pixel_directions,
    pixel_solid_angles,
    sample_planes,
    wrap_border,
)
from panoloc.core.geometry.rotations import rotations_of_axes
from panoloc.core.image.level import VALID_SHARE
from panoloc.core.image.rig_pyramid import RigPyramid, Windows
from panoloc.core.kernels.library import call, has_kernels_for

_SMOOTHING = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
_REACH = 3.0  # of the noise of edges
_AXES_AT_ONCE = 1024  # what they are to all edges stays in the processor's cache


@dataclass(frozen=True)
class Edges:
    """Pixels on edges: directions (E, 3), unit vectors of the rig, and normals (E, 3) of the planes of their edges, either way round.

    length_deg: how long all edges are together, those of which nothing was taken too.
    """

    directions: Tensor
    normals: Tensor
    length_deg: float = 0.0


def edges_of_photos(pyramid: RigPyramid, most_rows: int, config: LineConfig) -> Edges:
    """Return the strongest edges in each of equal squares of the photos, thinned to one pixel across; few or none where hardly any are.

    most_rows: to a sphere, on which they are looked for. Taken from everywhere: the strongest of all are those of one rug or picture, which
    may hang askew.
    """
    windows = pyramid.windows(min(most_rows, pyramid.finest_rows))
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


def alignment_ratio(off_square: Tensor, noise: float, aligned_share: float) -> Tensor:
    """Return how much likelier edges are along an axis than anywhere, of any shape.

    off_square: squared angles between edges and the way to the vanishing point of the axis, radians; noise: their standard deviation,
    radians. aligned_share: of all edges, that are along one of three axes. Edges that run anywhere have the density 1 / π.
    """
    peak = aligned_share / 3 * math.pi / (noise * math.sqrt(2 * math.pi)) / (1 - aligned_share)
    return (off_square * (-0.5 / noise**2)).exp() * peak


class LineSupport:
    """What edges say of where vanishing points are, in the axes of the rig."""

    def __init__(self, edges: Edges, config: LineConfig) -> None:
        half = pixel_directions(config.support_rows, 2 * config.support_rows, edges.normals.device)
        half = half[: config.support_rows // 2]
        upper = _support(half.flatten(0, 1), edges, config).view(half.shape[:2])
        # A vanishing point and the one opposite are the same.
        opposite = torch.roll(upper.flip(0), config.support_rows, dims=1)
        self._bordered = wrap_border(torch.cat((upper, opposite))[None])
        self._rows = config.support_rows
        self._of_axes: dict[int, Tensor] = {}

    @cached_property
    def by_chance(self) -> float:
        """Return what rotations have on average."""
        weights = pixel_solid_angles(self._rows, 2 * self._rows, self._bordered.device)
        return 3 * float((self._bordered[0, 1:-1, 1:-1] * weights).sum() / (4 * math.pi))

    def best_axes(self, count: int, least_contrast: float) -> Tensor | None:
        """Return the turn (3, 3) axes_from_rig, of `count` over all turns, that edges agree best with; None where that is by less than the
        least contrast better than by chance."""
        best, number = self.of_axes(count).max(0)
        if float(best) - self.by_chance < least_contrast:
            return None
        return rotations_of_axes(count, str(self._bordered.device))[number]

    def of_axes(self, count: int) -> Tensor:
        """Return what `of_rotations` returns, (K,), of `rotations_of_axes`, of `count` over all turns."""
        if count not in self._of_axes:
            self._of_axes[count] = self.of_rotations(rotations_of_axes(count, str(self._bordered.device)))
        return self._of_axes[count]

    def of_rotations(self, rotations: Tensor) -> Tensor:
        """Return the mean log-likelihood ratio (R,) of an edge, for rotations (R, 3, 3) axes_from_rig."""
        x, y, z = rotations.unbind(-1)
        per_rad = self._rows / math.pi
        u = (math.pi - torch.atan2(y, x)) * per_rad
        v = (math.pi / 2 - torch.asin(z.clamp(-1, 1))) * per_rad
        return (
            sample_planes(self._bordered, u.flatten()[None] + 0.5, v.flatten()[None] + 0.5)
            .view(len(rotations), 3)
            .sum(-1)
        )


def _support(axes: Tensor, edges: Edges, config: LineConfig) -> Tensor:
    """Return what each of axes (A, 3) adds to the mean log-likelihood ratio of the edges."""
    spread = math.radians(config.edge_noise_deg)
    if has_kernels_for(axes):
        support = axes.new_empty(len(axes))
        peak = float(alignment_ratio(torch.zeros(()), spread, config.aligned_share))
        rules = _REACH * spread, spread, peak, LEAST_SINE
        sides = axes, len(axes), edges.normals, edges.directions, len(edges.normals)
        call("line_support", *sides, *rules, support)
        return support
    sums = []
    for part in torch.split(axes, _AXES_AT_ONCE):
        off = part @ edges.normals.T
        # Edges that do not pass near an axis add nothing; few do.
        near = (off.abs() < _REACH * spread).flatten().nonzero()[:, 0]
        along = (part @ edges.directions.T).flatten()[near]
        sine_square = (1 - along.square()).clamp_min(LEAST_SINE**2)
        ratio = alignment_ratio(off.flatten()[near].square() / sine_square, spread, config.aligned_share)
        axis = near.div(max(1, len(edges.normals)), rounding_mode="floor")
        sums.append(torch.zeros(len(part), device=axes.device).index_add_(0, axis, ratio.log1p()))
    return torch.cat(sums) / max(1, len(edges.normals))
