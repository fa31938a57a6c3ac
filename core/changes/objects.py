"""From what the network says of cells to objects: each peak of middles is one, and what went and came again moved."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.network import CELL
from panoloc.core.changes.voxels import COLOR_FEATURES, VoxelGrid

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """Something that came to a place, or went from it.

    is_new: it came. low, high: (3,) corners of its box, metres. voxels: (M, 3) centres. certainty: 0..1, how probable it is that it did so.
    color: (3,) its mean colour, 0..1, in the light of the scan.
    """

    is_new: bool
    low: Array
    high: Array
    voxels: Array
    certainty: float
    color: Array

    @property
    def center(self) -> Array:
        """Return the middle of the box, (3,)."""
        return (self.low + self.high) / 2

    @property
    def size(self) -> Array:
        """Return the edges of the box, (3,) metres."""
        return self.high - self.low


def placed_objects(
    said: Tensor, features: Tensor, grid: VoxelGrid, inner: tuple[slice, ...], is_new: bool
) -> list[PlacedObject]:
    """Return the objects of a grid that came, or went.

    said: (OUTPUTS, X / CELL, ...) of the network. features: (NUM_FEATURES, X, Y, Z). inner: voxels that middles are looked for in.
    """
    near, belongs = said[:2].sigmoid()
    peak = (near == torch.nn.functional.max_pool3d(near[None], 3, 1, 1)[0]) & (near > CHANGES.likely)
    within = torch.zeros_like(peak)
    within[tuple(slice(part.start // CELL, -(-part.stop // CELL)) for part in inner)] = True
    cells = VoxelGrid(grid.low, tuple(near.shape), CELL * grid.side).centers().view(*near.shape, 3)
    inside = belongs.repeat_interleave(CELL, 0).repeat_interleave(CELL, 1).repeat_interleave(CELL, 2).flatten()
    color = features[COLOR_FEATURES].flatten(1)[3 * is_new :][:3] + 0.5
    voxels = grid.centers()
    found = []
    for at in (peak & within).nonzero():
        way, sides = (said[(slice(*part), *at)] for part in ((2, 5), (5, 8)))
        middle, half = cells[tuple(at)] + way, sides.exp() / 2
        apart = ((voxels - middle).abs() - half).amax(1)
        mine = (apart <= grid.side / 2) & (inside > CHANGES.likely_voxel)
        if not bool(mine.any()):
            mine = apart == apart.min()
        low, high, own = (each.double().numpy() for each in (middle - half, middle + half, voxels[mine]))
        found.append(
            PlacedObject(is_new, low, high, own, certainty_of(float(near[tuple(at)])), color[:, mine].mean(1).numpy())
        )
    return found


def certainty_of(likelihood: float) -> float:
    """Return how probable it is that something changed where the network says so with a likelihood, 0..1."""
    base, of_odds = CHANGES.certainty
    likelihood = min(likelihood, CHANGES.most_likely)
    return 1 / (1 + exp(-base - of_odds * log(likelihood / (1 - likelihood))))


def without_repeats(placed: Sequence[PlacedObject]) -> list[PlacedObject]:
    """Return objects without those that have most of their box in common with a surer one that did the same."""
    kept: list[PlacedObject] = []
    for each in sorted(placed, key=lambda one: -one.certainty):
        if all(each.is_new != other.is_new or not _repeats(each, other) for other in kept):
            kept.append(each)
    return kept


def pair_up(went: Sequence[PlacedObject], came: Sequence[PlacedObject]) -> list[tuple[int, int]]:
    """Return (number of what went, number of what came) where both are one thing that moved: alike in size and colour, the likest first."""
    costs = sorted((_unlikeness(a, b), i, j) for i, a in enumerate(went) for j, b in enumerate(came))
    pairs: list[tuple[int, int]] = []
    for cost, i, j in costs:
        # What stands where something like it stood was exchanged, or is there still.
        is_elsewhere = np.linalg.norm(went[i].center - came[j].center) > CHANGES.least_side_m
        # What is sure is stated, whatever unsure thing it may be alike.
        is_sure, is_too = (each.certainty >= CHANGES.sure for each in (went[i], came[j]))
        if cost < 1 and is_elsewhere and is_sure == is_too and all(i != a and j != b for a, b in pairs):
            pairs.append((i, j))
    return pairs


def _repeats(each: PlacedObject, other: PlacedObject) -> bool:
    shared = np.prod(np.maximum(np.minimum(each.high, other.high) - np.maximum(each.low, other.low), 0))
    is_same = shared > CHANGES.most_shared * min(np.prod(each.size), np.prod(other.size))
    return bool(is_same or np.linalg.norm(each.center - other.center) < CHANGES.least_apart_m)


def _unlikeness(first: PlacedObject, second: PlacedObject) -> float:
    """Return how unlike two objects are: 1 where size or colour differ by as much as they may."""
    # Turned about the vertical, width and depth change places.
    sides = [np.maximum([*sorted(each.size[:2]), each.size[2]], CHANGES.voxel_m) for each in (first, second)]
    size = np.abs(np.log(sides[0] / sides[1])).mean() / CHANGES.size_apart
    return float(np.hypot(size, np.linalg.norm(first.color - second.color) / CHANGES.color_apart))
