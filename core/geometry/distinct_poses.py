"""Which of many poses are different ones."""

import math

import numpy as np
import torch
from torch import Tensor

from panoloc.core.config import PoseDistance
from panoloc.core.kernels.library import call, has_kernels_for


def first_distinct(
    rotations: Tensor,
    positions: Tensor,
    near: PoseDistance,
    groups: Tensor | None = None,
    count: int | None = None,
) -> list[int]:
    """Return the numbers of poses (K,) that are near none before them that is returned, the first `count` of them.

    rotations: (K, 3, 3); positions: (K, 3) metres. Only poses of the same group (K,) are near each other, where there are groups.
    """
    least_trace = 1 + 2 * math.cos(math.radians(near.angle_deg))
    if has_kernels_for(rotations):
        kept = torch.empty(len(rotations), dtype=torch.int64)
        most = len(rotations) if count is None else count
        rules = least_trace, float(near.distance_m), most
        found = call("first_distinct", rotations, positions, groups, len(rotations), *rules, kept)
        return [int(k) for k in kept[:found].tolist()]
    of = torch.zeros_like(positions[:, :1]) if groups is None else groups[:, None].to(positions.dtype)
    # In one piece: each that a GPU is asked for is waited for.
    turns, places, numbers = np.split(
        torch.cat((rotations.flatten(1), positions, of), 1).cpu().numpy(), (9, 12), axis=1
    )
    taken = np.zeros(len(turns), dtype=bool)
    chosen: list[int] = []
    while not taken.all() and len(chosen) != count:
        first = int(taken.argmin())
        chosen.append(first)
        alike = turns @ turns[first] > least_trace
        alike &= np.square(places - places[first]).sum(1) < near.distance_m**2
        taken |= alike & (numbers[:, 0] == numbers[first, 0])
        taken[: first + 1] = True
    return chosen
