"""The space around the cameras as voxels, and what the scan and the photos say of each, however many photos there are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.evidence import PhotoEvidence
from panoloc.core.geometry.projection import pixels_towards

NUM_FEATURES = 23
LEAST_CHANGED = [3, 7]  # of photos that see a voxel in front of surfaces, or at one: the least
COLOR_FEATURES = slice(15, 21)  # of scan and photos, RGB each; then the edges of both
_MANY = 4.0  # photos that see a voxel; more say no more
_DENSE = 8.0  # points in a voxel


@dataclass(frozen=True)
class VoxelGrid:
    """Cubes of `side` metres. low: (3,) the corner of the first. shape: how many along x, y and z."""

    low: NDArray[np.float64]
    shape: tuple[int, int, int]
    side: float

    def centers(self) -> Tensor:
        """Return the centres (X Y Z, 3) float32, metres."""
        axes = [low + (np.arange(count) + 0.5) * self.side for low, count in zip(self.low, self.shape, strict=True)]
        return torch.from_numpy(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)).float()

    def numbers(self, points: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the number of the voxel of each of the points (N, 3) that lie in one, and which do (N,)."""
        places = np.floor((points - self.low) / self.side).astype(np.int64)
        inside = np.asarray(((places >= 0) & (places < np.array(self.shape))).all(axis=1))
        x, y, z = places[inside].T
        return np.asarray((x * self.shape[1] + y) * self.shape[2] + z), inside


def voxel_features(
    grid: VoxelGrid, points: NDArray[np.float32], colors: NDArray[np.float32], seen: Sequence[PhotoEvidence]
) -> Tensor:
    """Return (NUM_FEATURES, X, Y, Z) float32.

    points, colors: (N, 3) of the scan, colours 0..1. seen: what photos say, in any order. A voxel lies in front of the surface that was
    scanned in a direction, at it, or behind it; of the photos that see it in front or at it, how many there are, and the mean, least and
    largest of how changed they show that direction; how much their colours differ, and what they are; and the
    edges of scan and photos there.
    """
    numbers, inside = grid.numbers(points)
    size = int(np.prod(grid.shape))
    counts = np.bincount(numbers, minlength=size)
    scanned = [np.bincount(numbers, colors[inside][:, c], size) / np.maximum(counts, 1) for c in range(3)]
    occupied = torch.from_numpy(np.minimum(counts / _DENSE, 1.0)).float()
    views = _Sums(size)
    centers = grid.centers()
    for each in seen:
        views.add(each, centers, grid.side)
    planes = [occupied, *views.planes()]
    planes += [torch.where(occupied > 0, torch.from_numpy(c).float() - 0.5, 0.0) for c in scanned]
    planes += views.looks()
    return torch.stack(planes).view(NUM_FEATURES, *grid.shape)


class _Sums:
    """Sums over photos, of each of a number of voxels."""

    def __init__(self, size: int) -> None:
        # in front, at, behind the surface: how many photos, sum, least and largest of `changed`
        self._count, self._sum = torch.zeros(3, size), torch.zeros(3, size)
        self._least, self._most = torch.ones(3, size), torch.zeros(3, size)
        self._color, self._square, self._edges = torch.zeros(3, size), torch.zeros(size), torch.zeros(2, size)

    def add(self, seen: PhotoEvidence, centers: Tensor, side: float) -> None:
        """Add a photo."""
        relative = centers - seen.center
        distance = relative.norm(dim=1)
        pixel = pixels_towards(relative, CHANGES.rows)
        changed, known = seen.changed.flatten()[pixel], seen.known.flatten()[pixel] & (distance > CHANGES.near_m)
        depth = seen.depth.flatten()[pixel]
        reach = CHANGES.surface_m
        kinds = distance < depth - reach, (distance - depth).abs() <= reach, distance > depth + reach
        for row, kind in enumerate(kinds):
            here = known & kind
            self._count[row] += here
            self._sum[row] += changed * here
            self._least[row] = torch.where(here, torch.minimum(self._least[row], changed), self._least[row])
            self._most[row] = torch.where(here, torch.maximum(self._most[row], changed), self._most[row])
        open_ = known & ~kinds[2]
        color = seen.color.reshape(-1, 3)[pixel].T * open_
        self._color += color
        self._square += color.square().sum(0)
        self._edges += seen.edges.flatten(1)[:, pixel] * open_

    def planes(self) -> list[Tensor]:
        """Return 14 planes of what the photos say but for their colours."""
        found = []
        for row in range(3):
            count = self._count[row]
            known = count > 0
            found += [
                (count / _MANY).clamp(max=1.0),
                self._sum[row] / count.clamp_min(1),
                torch.where(known, self._least[row], 0.0),
                self._most[row],
            ]
        open_ = self._count[0] + self._count[1]
        mean = self._color / open_.clamp_min(1)
        spread = (self._square / open_.clamp_min(1) - mean.square().sum(0)).clamp_min(0).sqrt()
        return [*found, torch.where(open_ > 1, spread, 0.0), (open_ > 1).float()]

    def looks(self) -> list[Tensor]:
        """Return the mean colour that photos show, less 0.5, in 3 planes, and the mean edges of scan and photos; 0 where none shows any."""
        open_ = self._count[0] + self._count[1]
        color = torch.where(open_ > 0, self._color / open_.clamp_min(1) - 0.5, 0.0)
        return [*color, *(self._edges / open_.clamp_min(1))]
