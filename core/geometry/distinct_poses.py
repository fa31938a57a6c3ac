"""Which of many poses are different ones."""

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.config import PoseDistance

Flags = NDArray[np.bool_]

_FEW = 256  # poses; of more, all pairs would be millions, of which hardly any is asked for


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
    rows = _rows_of_pairs if len(rotations) <= _FEW else _rows
    alike = rows(rotations, positions, near, groups)
    taken = np.zeros(len(rotations), dtype=bool)
    kept: list[int] = []
    while not taken.all() and len(kept) != count:
        kept.append(int(taken.argmin()))
        taken |= alike(kept[-1])
        taken[: kept[-1] + 1] = True
    return kept


def _rows_of_pairs(
    rotations: Tensor, positions: Tensor, near: PoseDistance, groups: Tensor | None
) -> Callable[[int], Flags]:
    """Return what tells which poses are near one of them, all pairs being worked out at once: of few poses that costs less."""
    alike = torch.cdist(positions, positions) < near.distance_m
    alike &= rotations.flatten(1) @ rotations.flatten(1).T > _least_trace(near)
    if groups is not None:
        alike &= groups[:, None] == groups
    rows: Flags = alike.cpu().numpy()
    return lambda first: rows[first]


def _rows(rotations: Tensor, positions: Tensor, near: PoseDistance, groups: Tensor | None) -> Callable[[int], Flags]:
    """Return the same for many poses of which few are asked for."""
    of = torch.zeros_like(positions[:, :1]) if groups is None else groups[:, None].to(positions.dtype)
    # In one piece: each that a GPU is asked for is waited for.
    turns, places, numbers = np.split(
        torch.cat((rotations.flatten(1), positions, of), 1).cpu().numpy(), (9, 12), axis=1
    )
    least = _least_trace(near)

    def row(first: int) -> Flags:
        """Return which poses (N,) are near the one numbered `first` and in its group."""
        alike: Flags = turns @ turns[first] > least
        alike &= np.square(places - places[first]).sum(1) < near.distance_m**2
        alike &= numbers[:, 0] == numbers[first, 0]
        return alike

    return row


def _least_trace(near: PoseDistance) -> float:
    return 1 + 2 * math.cos(math.radians(near.angle_deg))
