"""Which of many poses are different ones."""

import math

import numpy as np
import torch
from torch import Tensor

from core.config import PoseDistance


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
    # All pairs at once: one by one they cost more than the rendering they save.
    alike = torch.cdist(positions, positions) < near.distance_m
    alike &= rotations.flatten(1) @ rotations.flatten(1).T > 1 + 2 * math.cos(math.radians(near.angle_deg))
    if groups is not None:
        alike &= groups[:, None] == groups
    rows = alike.cpu().numpy()
    taken = np.zeros(len(rows), dtype=bool)
    kept: list[int] = []
    while not taken.all() and len(kept) != count:
        kept.append(int(taken.argmin()))
        taken |= rows[kept[-1]]
        taken[: kept[-1] + 1] = True
    return kept
