"""Floors and ceilings of a building: the level planes at which walls begin and end.

A table, a shelf or a bed is level too, but walls go on below and above it. Where walls begin there is a floor, where they end
a ceiling. Lengths are compared with the pieces that a scan is cut into, so that neither unit nor up axis has to be known.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.scan.frame import Array
from panoloc.core.scan.voxel_thinning import column_bounds, group_by_voxel

_MOST_POINTS = 300_000
_POINTS_PER_CELL = 30
_FEWEST_POINTS = 6
_FEWEST_CELLS = 30
_FLATNESS = 0.15  # of the variance across a piece of surface over the least along it
_LEVEL, _UPRIGHT = 0.97, 0.2  # part of a unit normal along the vertical: at least, at most
_BINS_PER_CELL = 4
_WALL_STEP = 3.0  # walls on the one side of a floor or ceiling over those on the other
_LEAST_SHARE = 0.15  # of the largest plane
LEAST_STOREY_M = 1.9


@dataclass(frozen=True)
class Floor:
    """level_m: along the vertical. height_m: clear height up to the ceiling; None where no ceiling was scanned."""

    level_m: float
    height_m: float | None


@dataclass(frozen=True)
class SurfaceCells:
    """Pieces of surfaces, cubes of the edge `size`. centers, normals: (C, 3), the normals with either sign."""

    size: float
    centers: Array
    normals: Array


@dataclass(frozen=True)
class LevelPlane:
    """level: along the vertical. share: of the area of all surfaces. below, above: pieces of walls that are close to it."""

    level: float
    share: float
    below: int
    above: int

    @property
    def is_floor(self) -> bool:
        """Tell whether walls begin here."""
        return self.above > _WALL_STEP * self.below

    @property
    def is_ceiling(self) -> bool:
        """Tell whether walls end here."""
        return self.below > _WALL_STEP * self.above


def surface_cells(positions: Array) -> SurfaceCells:
    """Cut positions (N, 3) into cubes, large enough to hold some points each, and return those that are pieces of surfaces."""
    positions = positions[:: max(1, -(-len(positions) // _MOST_POINTS))]
    lowest, highest = column_bounds(positions)
    most = max(_FEWEST_CELLS, len(positions) / _POINTS_PER_CELL)
    size = max(float((highest - lowest).max()) / 200, 1e-9)
    while len((groups := group_by_voxel(positions, size, lowest)).starts) > 1.1 * most:
        size *= max(1.05, float(np.sqrt(len(groups.starts) / most)))
    counts = np.diff(groups.starts, append=len(positions))
    centers = groups.sums(positions) / counts[:, None]
    inside = positions[groups.order] - np.repeat(centers, counts, axis=0)
    products = (inside[:, :, None] * inside[:, None]).reshape(-1, 9)
    spread = np.add.reduceat(products, groups.starts).reshape(-1, 3, 3) / counts[:, None, None]
    variances, directions = np.linalg.eigh(spread)
    is_surface = (counts >= _FEWEST_POINTS) & (variances[:, 0] < _FLATNESS * variances[:, 1])
    return SurfaceCells(size, centers[is_surface], directions[is_surface, :, 0])


def level_planes(cells: SurfaceCells, axis: int = 2) -> list[LevelPlane]:
    """Return the large planes across an axis (0 to 2), in its order."""
    along, slope = cells.centers[:, axis], np.abs(cells.normals[:, axis])
    if len(along) < _FEWEST_CELLS:
        return []
    near, step = _BINS_PER_CELL, cells.size / _BINS_PER_CELL
    edges = np.arange(along.min() - 2 * cells.size, along.max() + 2 * cells.size, step)
    level, walls = (np.histogram(along[chosen], edges)[0] for chosen in (slope >= _LEVEL, slope <= _UPRIGHT))
    left = np.convolve(level, np.ones(3), "same")
    least = max(_LEAST_SHARE * left.max(), 3.0)
    found = []
    while left.max() >= least:
        peak = int(left.argmax())
        left[max(0, peak - near) : peak + near + 1] = 0
        part = slice(max(0, peak - 2), peak + 3)
        is_part = (slope >= _LEVEL) & (along >= edges[part.start]) & (along < edges[min(part.stop, len(level))])
        area, middle = int(is_part.sum()), float(np.median(along[is_part]))
        below = int(walls[max(0, peak - 2 * near) : max(0, peak - near // 2)].sum())
        above = int(walls[peak + near // 2 + 1 : peak + 2 * near + 1].sum())
        found.append(LevelPlane(middle, area / len(along), below, above))
    return sorted(found, key=lambda plane: plane.level)


def floors_of(positions: NDArray[np.float32] | Array) -> list[Floor]:
    """Return the floors of a building, bottom up; none where there is no building. positions: (N, 3) metres, z up.

    Parts of a storey whose floors lie at different levels are one floor: the largest of them.
    """
    planes = level_planes(surface_cells(np.asarray(positions, np.float64)))
    storeys: list[list[LevelPlane]] = []
    for plane in planes:
        if plane.is_floor and (not storeys or plane.level - storeys[-1][0].level >= LEAST_STOREY_M):
            storeys.append([plane])
        elif plane.is_floor:
            storeys[-1].append(plane)
    found = []
    for storey, above in zip(storeys, [*storeys[1:], None], strict=False):
        level = max(storey, key=lambda plane: plane.share).level
        top = np.inf if above is None else above[0].level + LEAST_STOREY_M / 2
        ceilings = [each for each in planes if each.is_ceiling and level + LEAST_STOREY_M <= each.level < top]
        height = max(ceilings, key=lambda plane: plane.share).level - level if ceilings else None
        found.append(Floor(round(level, 3), None if height is None else round(height, 3)))
    return found
