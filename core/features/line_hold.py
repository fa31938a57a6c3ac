"""The hold that lines have on rotations that are refined.

Where much of what a photo shows has changed, a pose can turn and move together and still fit nearly as well; which way edges
run does not change with the furniture. So where a rotation agrees with the lines, edges that nearly run along an axis of the walls want
to run along it, beside what the colours want.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import LineConfig
from panoloc.core.features.edge_model import LEAST_SINE, alignment_ratio
from panoloc.core.features.photo_edges import Edges


@dataclass(frozen=True)
class LineHold:
    """Of K poses: edges, and axes_from_map (K, 3, 3), in rows the axes along which the walls of each one's map are built.

    strength: (K,) >= 0, of the hold, beside the mean loss that the poses are refined by.
    """

    edges: Edges
    axes_from_map: Tensor
    strength: Tensor
    config: LineConfig

    @staticmethod
    def joined(parts: "Sequence[LineHold]") -> "LineHold":
        """Return the hold on all poses of several groups, one group after the other, for the same photos."""
        axes, strength = torch.cat([p.axes_from_map for p in parts]), torch.cat([p.strength for p in parts])
        return LineHold(parts[0].edges, axes, strength, parts[0].config)

    def take(self, chosen: Tensor) -> "LineHold":
        """Return the hold on some of the poses."""
        return LineHold(self.edges, self.axes_from_map[chosen], self.strength[chosen], self.config)

    def equations(self, rotations: Tensor) -> tuple[Tensor, Tensor]:
        """Return Hessian (K, 3, 3) and gradient (K, 3) by a turn of the rig, at rotations (K, 3, 3) map_from_rig, of half the mean squared
        angle between edges and the axes that they run along, over the noise; edges that run along none have no say."""
        edges, axes = self.edges, self.axes_from_map @ rotations
        noise = math.radians(self.config.hold_noise_deg)
        sine = (1 - (axes @ edges.directions.T).square()).clamp_min(LEAST_SINE**2).sqrt()  # (K, 3, E)
        off = (axes @ edges.normals.T) / sine
        ratio = alignment_ratio(off.square(), noise, self.config.aligned_share)
        each = self.strength / (noise**2 * len(edges.normals))
        weights = ratio / (1 + ratio.sum(1, keepdim=True)) * each[:, None, None]
        # A turn ω takes an axis a to a − ω x a, and n · a to n · a − ω · (a x n).
        by_turn = torch.linalg.cross(axes[:, :, None], edges.normals[None, None], dim=-1) / -sine[..., None]
        weighted = (by_turn * weights[..., None]).flatten(1, 2).transpose(1, 2)
        return weighted @ by_turn.flatten(1, 2), (weighted @ off.flatten(1)[..., None])[..., 0]
