"""What the surfaces of a scan say: the axes along which its walls are built, if they are built along any, and how exact the scan is."""

import math

import torch
from torch import Tensor

from panoloc.core.options import ScanOptions

_MOST_POINTS = ScanOptions.max_points_used  # of more, some, in larger cells
_CELL_M = 0.2
_FEWEST_POINTS = 8  # of a cell
_FLATNESS = 0.05  # of the variance across a cell's surface over the least along it
_SURFACE_FLATNESS = 0.3  # likewise, of a surface that may be thick
_STEEP = 0.2  # cosine between the normal of a wall and the vertical
_BINS = 90  # of a quarter turn
_NEAR_DEG = 3.0


def wall_axes(positions: Tensor) -> Tensor:
    """Return axes_from_map (3, 3), a turn about the vertical that brings x and y along most of the walls; none where there are no walls.

    positions: (N, 3) metres, z up.
    """
    normals, weights = _wall_normals(positions)
    if len(normals) == 0:
        return torch.eye(3, device=positions.device)
    quarter = math.pi / 2
    azimuth = torch.atan2(normals[:, 1], normals[:, 0]) % quarter
    number = (azimuth * (_BINS / quarter)).long().clamp(0, _BINS - 1)
    bins = torch.zeros(_BINS, dtype=weights.dtype, device=weights.device).index_add_(0, number, weights)
    around = sum(torch.roll(bins, k) for k in (-2, -1, 0, 1, 2))
    assert isinstance(around, Tensor)
    middle = (float(around.argmax()) + 0.5) * quarter / _BINS
    off = (azimuth - middle + quarter / 2) % quarter - quarter / 2
    near = off.abs() < math.radians(_NEAR_DEG)
    turn = middle + float((off * weights)[near].sum() / weights[near].sum())
    c, s = math.cos(turn), math.sin(turn)
    return torch.tensor([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], device=positions.device)


def surface_thickness(positions: Tensor) -> float:
    """Return how thick surfaces of a scan are, metres: the standard deviation across them, of half of its pieces less.

    positions: (N, 3) metres. Noise of a scanner makes them millimetres thick, stations that do not fit each other centimetres.
    """
    variances, _, _ = _pieces(positions)
    is_surface = variances[:, 0] < _SURFACE_FLATNESS * variances[:, 1]
    return float(variances[is_surface, 0].clamp_min(0).sqrt().median()) if bool(is_surface.any()) else 0.0


def _wall_normals(positions: Tensor) -> tuple[Tensor, Tensor]:
    """Return the normals (C, 3) of cells of the scan that are pieces of walls, and how many points each has (C,)."""
    variances, directions, weights = _pieces(positions)
    normals = directions[:, :, 0]
    walls = (variances[:, 0] < _FLATNESS * variances[:, 1]) & (normals[:, 2].abs() < _STEEP)
    return normals[walls].float(), weights[walls]


def _pieces(positions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the variances (C, 3), rising, of the points in each cell, along directions (C, 3, 3), and how many there are (C,)."""
    stride = max(1, -(-len(positions) // _MOST_POINTS))
    positions = positions[::stride]
    cell = ((positions - positions.amin(0)) / (_CELL_M * math.sqrt(stride))).long()
    size = cell.amax(0) + 1
    number = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, which, count = torch.unique(number, return_inverse=True, return_counts=True)
    weights = count.double()
    mean = positions.new_zeros((len(count), 3), dtype=torch.float64).index_add_(0, which, positions.double())
    off = positions.double() - (mean / weights[:, None])[which]
    products = (off[:, :, None] * off[:, None]).flatten(1)
    spread = products.new_zeros((len(count), 9)).index_add_(0, which, products).view(-1, 3, 3) / weights[:, None, None]
    dense = count >= _FEWEST_POINTS
    variances, directions = torch.linalg.eigh(spread[dense])
    return variances, directions, weights[dense]
