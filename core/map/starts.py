"""Translation starts: where the search puts the camera.

Octree starts are the centroids of the empty leaves of an octree over the points: free space is covered by few large leaves in
the middle of rooms and smaller ones between furniture. Grid starts suit open spaces. Both can be confined to a region.

Paper: §3.3 and supplement.
Deviation: leaves are no larger than the basin of convergence of the refinement (about 0.5 m in furnished rooms, measured), so the
number of starts follows the free volume instead of being fixed; starts closer together than that add nothing and are thinned.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import interpolate, max_pool3d

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
        # Nearer to each other than a largest leaf and one beside it that is half as large, leaves show the same.
        starts = _thin(_empty_leaves(positions, lower, upper, spacing, config.clearance_m), (spacing + spacing / 2) / 2)
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
    """Return the empty leaves of an octree whose largest cells have the edge `spacing` and whose smallest a quarter of it.

    All keep clear of the points, in whole smallest cells.
    """
    smallest = spacing / 4
    if not bool((upper > lower).all()):
        return Starts(np.zeros((0, 3)), np.zeros(0))
    cells = np.maximum(1, np.ceil((upper - lower) / spacing)).astype(int)
    origin = (lower + upper - cells * spacing) / 2
    index = np.floor((positions - origin) / smallest).astype(np.int64)
    index = index[((index >= 0) & (index < 4 * cells)).all(axis=1)]
    taken = torch.zeros((1, 1, *(4 * cells).tolist()))
    taken[0, 0, index[:, 0], index[:, 1], index[:, 2]] = 1
    steps = round(clearance / smallest)
    near = max_pool3d(taken, 2 * steps + 1, stride=1, padding=steps)
    centers, sizes = [], []
    divided = torch.ones((1, 1, *cells.tolist()))
    for side in (4, 2, 1):
        full = max_pool3d(taken, side)
        middle = near[..., side // 2 :: side, side // 2 :: side, side // 2 :: side]
        where = ((divided > full) & (middle == 0))[0, 0].nonzero().numpy()
        centers.append(origin + (where + 0.5) * smallest * side)
        sizes.append(np.full(len(where), smallest * side))
        divided = interpolate(full, scale_factor=2.0)
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
    return Starts(points[kept], starts.leaf_sizes[order][kept])
