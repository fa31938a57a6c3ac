"""Group points by the voxel that they lie in."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAX_PACKED = 1 << 62


@dataclass(frozen=True)
class VoxelGroups:
    """Points sorted by voxel. order: (n,) point numbers, ascending inside a voxel. starts: (m,) first of each voxel."""

    order: NDArray[np.int64]
    starts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.starts)

    def sums(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return the sum of `values`, (n,) or (n, k), over each voxel as float64."""
        return np.add.reduceat(np.take(values, self.order, axis=0), self.starts, axis=0, dtype=np.float64)

    def first_points(self) -> NDArray[np.int64]:
        """Return for each voxel the number of its first point."""
        return self.order[self.starts]


def group_by_voxel(positions: NDArray[np.float64], voxel_size: float, anchor: NDArray[np.float64]) -> VoxelGroups:
    """Group finite `positions`, (n, 3), by voxels of `voxel_size` whose corner is at `anchor`.

    The result does not depend on the machine's sorting algorithm: ties are broken by the point number.
    """
    num_points = len(positions)
    keys = _voxel_keys(positions, voxel_size, anchor)
    if keys.ndim == 1 and (int(keys.max()) + 1) * num_points < _MAX_PACKED:
        # Sorting one word of key and number is several times as fast as a stable argsort.
        packed = keys * num_points
        packed += np.arange(num_points)
        packed.sort()
        sorted_keys = packed // num_points
        order = packed - sorted_keys * num_points
    elif keys.ndim == 1:
        order = np.argsort(keys, kind="stable")
        sorted_keys = keys[order]
    else:
        order = np.lexsort(keys.T[::-1])
        steps = (np.diff(keys[order], axis=0) != 0).any(axis=1)
        sorted_keys = np.concatenate([[0], np.cumsum(steps)])
    return VoxelGroups(order, np.flatnonzero(np.diff(sorted_keys, prepend=-1)))


def column_bounds(table: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the smallest and largest of each column of `table`, (n, k) with n > 0.

    Column by column, because numpy's min(axis=0) takes twenty times as long on a table of few columns.
    """
    columns = [table[:, number] for number in range(table.shape[1])]
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def _voxel_keys(positions: NDArray[np.float64], voxel_size: float, anchor: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return one non-negative number per point, (n,), or (n, 3) where one number cannot hold the extent."""
    cells = np.floor((positions - anchor) / voxel_size).astype(np.int64)
    lowest, highest = column_bounds(cells)
    cells -= lowest
    spans = [int(span) + 1 for span in highest - lowest]
    if spans[0] * spans[1] * spans[2] >= _MAX_PACKED:
        return cells
    return (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
