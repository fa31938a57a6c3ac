"""From voxels that came or went to objects: what votes for the same middle is one, and what went and came again moved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.changes.config import CHANGES

Array = NDArray[np.float64]
_AT_ONCE = 1024  # votes that are compared with all others


@dataclass(frozen=True, eq=False)
class LikelyVoxels:
    """Voxels that came, or went: centers (M, 3), middles (M, 3) of the objects that they vote for, likelihood (M,), colors (M, 3)."""

    is_new: bool
    centers: Array
    middles: Array
    likelihood: Array
    colors: Array


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """Something that came to a place, or went from it.

    is_new: it came. low, high: (3,) corners of its box, metres. voxels: (M, 3) centres. likelihood: mean of its voxels, 0..1. color: (3,)
    its mean colour, 0..1, in the light of the scan.
    """

    is_new: bool
    low: Array
    high: Array
    voxels: Array
    likelihood: float
    color: Array

    @property
    def center(self) -> Array:
        """Return the middle of the box, (3,)."""
        return (self.low + self.high) / 2

    @property
    def size(self) -> Array:
        """Return the edges of the box, (3,) metres."""
        return self.high - self.low


def placed_objects(parts: Sequence[LikelyVoxels]) -> list[PlacedObject]:
    """Return the objects that voxels of one or more tiles make up; all came, or all went."""
    if not sum(len(part.centers) for part in parts):
        return []
    centers, middles = (np.concatenate([getattr(p, name) for p in parts]) for name in ("centers", "middles"))
    likelihood, colors = (np.concatenate([getattr(p, name) for p in parts]) for name in ("likelihood", "colors"))
    group = _groups(middles, likelihood)
    return [
        _object(parts[0].is_new, centers[mine], middles[mine], likelihood[mine], colors[mine])
        for mine in (group == number for number in range(int(group.max()) + 1))
        if likelihood[mine].sum() >= CHANGES.least_voxels
    ]


def pair_up(went: Sequence[PlacedObject], came: Sequence[PlacedObject]) -> list[tuple[int, int]]:
    """Return (number of what went, number of what came) where both are one thing that moved: alike in size and colour, the likest first."""
    costs = sorted((_unlikeness(a, b), i, j) for i, a in enumerate(went) for j, b in enumerate(came))
    pairs: list[tuple[int, int]] = []
    for cost, i, j in costs:
        # What stands where something like it stood was exchanged, or is there still.
        is_elsewhere = np.linalg.norm(went[i].center - came[j].center) > CHANGES.least_side_m
        if cost < 1 and is_elsewhere and all(i != a and j != b for a, b in pairs):
            pairs.append((i, j))
    return pairs


def _groups(middles: Array, weights: Array) -> NDArray[np.int64]:
    """Return the group (M,) of each vote (M, 3), from 0: every vote climbs to the densest place within reach (quick shift)."""
    cells, of_vote = np.unique(np.floor(middles / CHANGES.vote_m).astype(np.int64), axis=0, return_inverse=True)
    of_vote = of_vote.ravel()
    mass = torch.from_numpy(np.bincount(of_vote, weights)).float()
    places = torch.from_numpy((cells + 0.5) * CHANGES.vote_m).float()
    density, parents = torch.zeros(len(cells)), []
    for part in torch.split(torch.arange(len(cells)), _AT_ONCE):
        density[part] = (-0.5 * (torch.cdist(places[part], places) / CHANGES.vote_blur_m).square()).exp() @ mass
    density += 1e-6 * torch.arange(len(cells))  # no two are equally dense
    for part in torch.split(torch.arange(len(cells)), _AT_ONCE):
        near = torch.cdist(places[part], places) <= CHANGES.vote_reach_m
        parents.append((near * density).argmax(1))
    parent = torch.cat(parents)
    while not torch.equal(higher := parent[parent], parent):
        parent = higher
    return np.asarray(np.unique(parent.numpy(), return_inverse=True)[1].ravel()[of_vote])


def _object(is_new: bool, centers: Array, middles: Array, likelihood: Array, colors: Array) -> PlacedObject:
    half = CHANGES.voxel_m / 2
    low, high = (np.quantile(centers, q, axis=0) + s * half for q, s in ((0.02, -1), (0.98, 1)))
    # Votes say where the middle is, even of what is seen in part: the box grows on the side that is missing.
    shift = np.average(middles, axis=0, weights=likelihood) - (low + high) / 2
    low, high = low + np.minimum(2 * shift, 0), high + np.maximum(2 * shift, 0)
    color = np.average(colors, axis=0, weights=likelihood)
    return PlacedObject(is_new, low, high, centers, float(likelihood.mean()), color)


def _unlikeness(first: PlacedObject, second: PlacedObject) -> float:
    """Return how unlike two objects are: 1 where size or colour differ by as much as they may."""
    # Turned about the vertical, width and depth change places.
    sides = [np.maximum([*sorted(each.size[:2]), each.size[2]], CHANGES.voxel_m) for each in (first, second)]
    size = np.abs(np.log(sides[0] / sides[1])).mean() / CHANGES.size_apart
    return float(np.hypot(size, np.linalg.norm(first.color - second.color) / CHANGES.color_apart))
