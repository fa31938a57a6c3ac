"""Which of many poses are different ones."""

import math

import torch
from torch import Tensor


def first_distinct(
    rotations: Tensor, positions: Tensor, distance_m: float, angle_deg: float, groups: Tensor | None = None
) -> list[int]:
    """Return the numbers of poses (K,) that are near none before them that is returned.

    rotations: (K, 3, 3); positions: (K, 3) metres. Near: closer than both limits, and of the same group (K,) where there are groups.
    """
    # All pairs at once: one by one they cost more than the rendering they save.
    near = torch.cdist(positions, positions) < distance_m
    near &= rotations.flatten(1) @ rotations.flatten(1).T > 1 + 2 * math.cos(math.radians(angle_deg))
    if groups is not None:
        near &= groups[:, None] == groups
    kept: list[int] = []
    for k, row in enumerate(near.tolist()):
        if not any(row[other] for other in kept):
            kept.append(k)
    return kept
