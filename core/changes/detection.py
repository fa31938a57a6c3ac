"""What came and what went: the order of the steps is written here.

Each photo is compared with the scan from its pose; space becomes voxels that the photos around have their say on; a small network tells
where the middles of things are that came or went.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.evidence import PhotoEvidence
from panoloc.core.changes.network import MULTIPLE, VoxelNetwork
from panoloc.core.changes.objects import PlacedObject, placed_objects, without_repeats
from panoloc.core.changes.voxels import LEAST_CHANGED, VoxelGrid, voxel_features


def find_placed_objects(
    network: VoxelNetwork, points: NDArray[np.float32], colors: NDArray[np.float32], seen: Sequence[PhotoEvidence]
) -> list[PlacedObject]:
    """Return what came and what went. points, colors: (N, 3) of the scan, colours 0..1. seen: what photos say, in any order."""
    found: list[PlacedObject] = []
    for grid, inner in _tiles(points, seen):
        features = voxel_features(grid, points, colors, _nearest(grid, seen))
        if bool((features[LEAST_CHANGED] > CHANGES.least_changed).any()):
            with torch.inference_mode():
                said = network(features[None])[0]
            for row in (0, 1):
                found += placed_objects(said[row], features, grid, inner, is_new=row == 1)
    return without_repeats(found)


def _nearest(grid: VoxelGrid, seen: Sequence[PhotoEvidence]) -> list[PhotoEvidence]:
    """Return the photos taken nearest to the middle of a tile: far ones add time, not knowledge."""
    middle = torch.from_numpy(grid.low + np.array(grid.shape) * grid.side / 2).float()
    return sorted(seen, key=lambda each: float((each.center - middle).norm()))[: CHANGES.most_photos]


def _tiles(points: NDArray[np.float32], seen: Sequence[PhotoEvidence]) -> Iterator[tuple[VoxelGrid, tuple[slice, ...]]]:
    """Yield grids that overlap, within reach of the cameras, and for which of their voxels each is there."""
    centers = np.stack([each.center.numpy() for each in seen])
    within = [np.quantile(points, q, axis=0) + s * 1.5 * CHANGES.voxel_m for q, s in ((0.0005, -1), (0.9995, 1))]
    low = np.maximum(within[0], centers.min(0) - CHANGES.reach_m)
    high = np.minimum(within[1], centers.max(0) + CHANGES.reach_m)
    side, size, margin = CHANGES.voxel_m, CHANGES.tile, CHANGES.margin
    shape = np.maximum(np.ceil((high - low) / side).astype(int), 1)
    starts = [range(0, count, size) for count in shape]
    for corner in np.array(np.meshgrid(*starts, indexing="ij")).reshape(3, -1).T:
        first, last = np.maximum(corner - margin, 0), np.minimum(corner + size + margin, shape)
        padded = np.ceil((last - first) / MULTIPLE).astype(int) * MULTIPLE
        grid = VoxelGrid(low + first * side, (int(padded[0]), int(padded[1]), int(padded[2])), side)
        inner = tuple(
            slice(int(a), int(b)) for a, b in zip(corner - first, np.minimum(corner + size, shape) - first, strict=True)
        )
        yield grid, inner
