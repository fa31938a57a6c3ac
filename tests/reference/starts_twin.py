"""Starts by recursion over cells, points and pairs."""

import itertools

import numpy as np
from numpy.typing import NDArray

from panoloc.core.config import StartsConfig

Array = NDArray[np.float64]
Leaf = tuple[tuple[float, ...], float]


def octree_leaves(points: Array, lower: Array, upper: Array, spacing: float, clearance: float) -> list[Leaf]:
    """Return centre and edge of the empty leaves whose middle keeps the clearance and lies within the bounds.

    The root cells, of edge `spacing`, are centred on the bounds; a cell that holds a point is divided, twice at most. The clearance is
    counted in cells of the smallest size, along each axis.
    """
    num = [max(1, int(np.ceil((high - low) / spacing))) for low, high in zip(lower, upper, strict=True)]
    origin = np.array([(low + high) / 2 - n * spacing / 2 for low, high, n in zip(lower, upper, num, strict=True)])
    smallest = spacing / 4
    occupied = {tuple(np.floor((point - origin) / smallest).astype(int)) for point in points}
    occupied = {cell for cell in occupied if all(0 <= c < 4 * n for c, n in zip(cell, num, strict=True))}
    taken, steps = np.array(sorted(occupied)), round(clearance / smallest)

    def leaves(corner: tuple[int, ...], side: int) -> list[Leaf]:
        inside = itertools.product(*(range(c, c + side) for c in corner))
        if not any(cell in occupied for cell in inside):
            middle = tuple(c + side // 2 for c in corner)
            if (np.abs(taken - middle).max(axis=1) <= steps).any():
                return []
            center = origin + (np.array(corner) + side / 2) * smallest
            return [(tuple(center), side * smallest)] if (lower <= center).all() and (center <= upper).all() else []
        if side == 1:
            return []
        half = side // 2
        corners = itertools.product(*((c, c + half) for c in corner))
        return [leaf for each in corners for leaf in leaves(each, half)]

    roots = itertools.product(*(range(0, 4 * n, 4) for n in num))
    return [leaf for root in roots for leaf in leaves(root, 4)]


def thinned(leaves: list[Leaf], distance: float) -> list[Leaf]:
    """Keep leaves, the largest first and then by z, y and x, that are at least `distance` from all kept before."""
    kept: list[Leaf] = []
    for center, edge in sorted(leaves, key=lambda leaf: (-leaf[1], leaf[0][2], leaf[0][1], leaf[0][0])):
        if all(np.linalg.norm(np.subtract(center, other)) >= distance for other, _ in kept):
            kept.append((center, edge))
    return kept


def octree_starts(points: Array, config: StartsConfig, region: tuple[Array, Array] | None = None) -> list[Leaf]:
    """Return the starts; the spacing grows until there are no more than `config.max_starts`."""
    lower, upper = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    if region is not None:
        lower, upper = np.maximum(lower, region[0]), np.minimum(upper, region[1])
    spacing = config.spacing_m
    while True:
        starts = thinned(octree_leaves(points, lower, upper, spacing, config.clearance_m), 0.75 * spacing)
        if len(starts) <= config.max_starts:
            return starts
        spacing *= max(1.02, (len(starts) / config.max_starts) ** (1 / 3))
