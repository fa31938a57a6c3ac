"""Translation starts: where the search puts the camera.

Octree starts are the centroids of the empty leaves of an octree over the points: free space is covered by few large leaves in
the middle of rooms and smaller ones between furniture. Grid starts suit open spaces. Both can be confined to a region.

Paper: §3.3 and supplement.
Deviation: leaves are no larger than the basin of convergence of the refinement (about 0.5 m in furnished rooms, measured), so the
number of starts follows the free volume instead of being fixed; starts closer together than that add nothing and are thinned.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from panoloc.core.config import StartsConfig
from panoloc.core.errors import OptionsError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Starts:
    """Positions tried by the search: `positions` (T, 3) float64 metres, `leaf_sizes` (T,) float64 metres (edge lengths)."""

    positions: FloatArray
    leaf_sizes: FloatArray

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> "Starts":
        """Return the chosen starts, by mask or by number."""
        return Starts(self.positions[keep], self.leaf_sizes[keep])


def octree_starts(
    positions: NDArray[np.float32], config: StartsConfig, region: tuple[FloatArray, FloatArray] | None = None
) -> Starts:
    """Return the centroids of the empty leaves of an octree over `positions` (N, 3) metres, thinned to the spacing.

    region: (min, max), each (3,), to stay inside. The spacing grows where the free volume holds more than `config.max_starts`.
    Raises OptionsError when no start fits.
    """
    lower, upper = _extent(positions, config.stray_share, region)
    volume = float(np.prod(np.maximum(upper - lower, 1.0)))
    spacing = max(config.spacing_m, 4 * (volume / config.max_cells) ** (1 / 3))
    for _ in range(12):
        starts = _empty_leaves(positions, lower, upper, spacing, config.clearance_m)
        starts = _thin(starts, config.thinning_share * spacing)
        if len(starts) <= config.max_starts:
            break
        spacing *= max(1.02, (len(starts) / config.max_starts) ** (1 / 3))
    if len(starts) == 0:
        center = (lower + upper) / 2
        if region is not None and not bool((upper > lower).all()):
            raise OptionsError(
                "starts.region: no part of it lies within the scan; give a region inside the scan's bounds"
            )
        return Starts(center[None], np.array([spacing]))
    return starts


def grid_starts(
    positions: NDArray[np.float32], config: StartsConfig, region: tuple[FloatArray, FloatArray] | None = None
) -> Starts:
    """Return a regular grid over the scan's bounds or the region (paper, supplement: open spaces), at most `config.max_starts`."""
    lower, upper = region if region is not None else _extent(positions, config.stray_share)
    if not bool((upper > lower).all()):
        raise OptionsError(
            f"starts.region: expected min below max on every axis, got {lower.tolist()} and {upper.tolist()}"
        )
    spacing = config.spacing_m
    while True:
        counts = np.maximum(1, np.round((upper - lower) / spacing)).astype(int)
        if counts.prod() <= config.max_starts:
            break
        spacing *= 1.05
    axes = [low + (np.arange(n) + 0.5) * (high - low) / n for low, high, n in zip(lower, upper, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return Starts(grid, np.full(len(grid), spacing))


def _extent(
    positions: NDArray[np.float32], stray_share: float, region: tuple[FloatArray, FloatArray] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds without the outermost points (strays far outside would spend the starts), cut to the region."""
    sample = positions[:: max(1, len(positions) // 200_000)].astype(np.float64)
    lower, upper = np.quantile(sample, stray_share, axis=0), np.quantile(sample, 1 - stray_share, axis=0)
    if region is None:
        return lower, upper
    return np.maximum(lower, region[0]), np.minimum(upper, region[1])


def _empty_leaves(
    positions: NDArray[np.float32], lower: FloatArray, upper: FloatArray, spacing: float, clearance: float
) -> Starts:
    """Return the empty leaves of an octree whose largest cells have the edge `spacing` and whose smallest a quarter of it."""
    smallest = spacing / 4
    if not bool((upper > lower).all()):
        return Starts(np.zeros((0, 3)), np.zeros(0))
    cells = np.maximum(1, np.ceil((upper - lower) / spacing)).astype(int)
    margin = (cells * spacing - (upper - lower)) / 2
    origin = lower - margin
    fine = cells * 4
    index = np.floor((positions - origin) / smallest).astype(np.int64)
    index = index[((index >= 0) & (index < fine)).all(axis=1)]
    occupied = np.zeros(tuple(fine), dtype=bool)
    occupied[index[:, 0], index[:, 1], index[:, 2]] = True
    near = _dilate(occupied, max(0, round(clearance / smallest)))
    centers, sizes = [], []
    parent_is_leaf = np.zeros(tuple(cells), dtype=bool)
    for level in range(3):
        side = 4 >> level
        full = _pool_any(occupied, side)
        blocked = near[side // 2 :: side, side // 2 :: side, side // 2 :: side]
        covered = parent_is_leaf if level == 0 else _double(parent_is_leaf)
        leaf = ~full & ~covered
        where = np.argwhere(leaf & ~blocked)
        centers.append(origin + (where + 0.5) * smallest * side)
        sizes.append(np.full(len(where), smallest * side))
        parent_is_leaf = leaf | covered
    found = np.concatenate(centers)
    inside = ((found >= lower) & (found <= upper)).all(axis=1)
    return Starts(found[inside], np.concatenate(sizes)[inside])


def _thin(starts: Starts, distance: float) -> Starts:
    """Keep leaves, the largest first, that are at least `distance` from every leaf kept before."""
    order = np.lexsort((*starts.positions.T, -starts.leaf_sizes))
    points = starts.positions[order]
    kept: list[int] = []
    buckets: dict[tuple[int, int, int], list[int]] = {}
    cells = np.floor(points / distance).astype(int)
    around = [(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)]
    for i, (x, y, z) in enumerate(cells.tolist()):
        close = [j for a, b, c in around for j in buckets.get((x + a, y + b, z + c), ())]
        if close and bool((((points[close] - points[i]) ** 2).sum(axis=1) < distance * distance).any()):
            continue
        kept.append(i)
        buckets.setdefault((x, y, z), []).append(i)
    return starts.take(order[np.array(kept, dtype=np.int64)])


def _pool_any(grid: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    x, y, z = grid.shape
    blocks = grid.reshape(x // side, side, y // side, side, z // side, side)
    return np.asarray(np.any(blocks, axis=(1, 3, 5)), dtype=np.bool_)


def _double(grid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return grid.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)


def _dilate(grid: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Grow the true cells by `steps` cells along each axis."""
    for axis in range(3):
        padded = np.pad(grid, [(steps, steps) if each == axis else (0, 0) for each in range(3)])
        grid = np.asarray(sliding_window_view(padded, 2 * steps + 1, axis).any(-1))
    return grid
