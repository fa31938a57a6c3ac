"""How well edges agree with lines that run along three axes at right angles, for any turn of the camera.

Rooms are built along three axes, and so is most of what stands in them. Each edge either runs towards the vanishing point of an axis, or in
any direction: the model of Coughlan and Yuille (*Manhattan World*, ICCV 1999), of which the logarithm of the likelihood ratio is taken.
Axes are looked up one by one in a map of the sphere, for an edge seldom agrees with two: so any number of turns costs three look-ups each.
"""

import math

import torch
from torch import Tensor

from panoloc.core.config import LineConfig
from panoloc.core.features.photo_edges import Edges
from panoloc.core.geometry.projection import (
    LEAST_SINE,
    pixel_directions,
    pixel_solid_angles,
    sample_planes,
    wrap_border,
)
from panoloc.core.geometry.rotations import rotations_of_axes
from panoloc.core.kernels.library import call, has_kernels_for


def alignment_ratio(off_square: Tensor, noise: float, aligned_share: float) -> Tensor:
    """Return how much likelier edges are along an axis than anywhere, of any shape.

    off_square: squared angles between edges and the way to the vanishing point of the axis, radians; noise: their standard deviation,
    radians. aligned_share: of all edges, that are along one of three axes. Edges that run anywhere have the density 1 / π.
    """
    peak = aligned_share / 3 * math.pi / (noise * math.sqrt(2 * math.pi)) / (1 - aligned_share)
    return (off_square * (-0.5 / noise**2)).exp() * peak


_REACH = 3.0  # of the noise of edges
_AXES_AT_ONCE = 1024  # what they are to all edges stays in the processor's cache


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

    @property
    def by_chance(self) -> float:
        """Return what rotations have on average."""
        weights = pixel_solid_angles(self._rows, 2 * self._rows, self._bordered.device)
        return 3 * float((self._bordered[0, 1:-1, 1:-1] * weights).sum() / (4 * math.pi))

    def contrast(self, count: int) -> float:
        """Return by how much edges agree better with the best turn of axes at right angles, of `count` over all turns, than by chance."""
        every = rotations_of_axes(count, str(self._bordered.device))
        return float(self.of_rotations(every).max()) - self.by_chance

    def of_rotations(self, rotations: Tensor) -> Tensor:
        """Return the mean log-likelihood ratio (R,) of an edge, for rotations (R, 3, 3) axes_from_rig."""
        x, y, z = rotations.unbind(-1)
        per_rad = self._rows / math.pi
        u = (math.pi - torch.atan2(y, x)) * per_rad
        v = (math.pi / 2 - torch.asin(z.clamp(-1, 1))) * per_rad
        return sample_planes(self._bordered, u.flatten()[None], v.flatten()[None]).view(len(rotations), 3).sum(-1)


def _support(axes: Tensor, edges: Edges, config: LineConfig) -> Tensor:
    """Return what each of axes (A, 3) adds to the mean log-likelihood ratio of the edges."""
    spread = math.radians(config.edge_noise_deg)
    if has_kernels_for(axes):
        support = axes.new_empty(len(axes))
        peak = float(alignment_ratio(torch.zeros(()), spread, config.aligned_share))
        rules = _REACH * spread, spread, peak, LEAST_SINE
        sides = axes, len(axes), edges.normals, edges.directions, edges.count
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
