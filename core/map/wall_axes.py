"""What the surfaces of a scan say: the axes along which its walls are built, if they are built along any, and how exact the scan is."""

import math

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES

_CELL_M = 0.2
_FLATNESS = 0.05  # of the variance across a piece of wall over the least along it
_SURFACE_FLATNESS = 0.3  # likewise, of a surface that may be thick


def wall_axes(positions: Tensor) -> Tensor:
    """Return axes_from_map (3, 3), a turn about the vertical that brings x and y along most of the walls; none where there are no walls.

    positions: (N, 3) metres, z up. A surface counts by how much of its normal is level.
    """
    _, normals, weights = _surfaces(positions, _FLATNESS)
    weights = weights * normals[:, :2].square().sum(1)
    quarter = math.pi / 2
    azimuth, order = (torch.atan2(normals[:, 1], normals[:, 0]) % quarter).sort()
    weights, near = weights[order], math.radians(DISTANCES.same.angle_deg)
    # The window around each normal of all others within `near` of it, a quarter turn being a full circle.
    sums = torch.nn.functional.pad(weights.repeat(3).cumsum(0), (1, 0))
    circle = torch.cat((azimuth - quarter, azimuth, azimuth + quarter))
    first, last = torch.searchsorted(circle, azimuth - near), torch.searchsorted(circle, azimuth + near)
    around = sums[last] - sums[first]
    if len(around) == 0 or float(weights.sum()) < 1e-6 * len(positions):
        return torch.eye(3, device=positions.device)
    off = (azimuth - azimuth[around.argmax()] + quarter / 2) % quarter - quarter / 2
    is_near = off.abs() < near
    turn = float(azimuth[around.argmax()] + (off * weights)[is_near].sum() / weights[is_near].sum())
    c, s = math.cos(turn), math.sin(turn)
    return torch.tensor([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], device=positions.device)


def surface_thickness(positions: Tensor) -> float:
    """Return how thick surfaces of a scan are, metres: the standard deviation across them, of half of its pieces less.

    positions: (N, 3) metres. Noise of a scanner makes them millimetres thick, stations that do not fit each other centimetres.
    """
    across, _, _ = _surfaces(positions, _SURFACE_FLATNESS)
    return float(across.clamp_min(0).sqrt().median()) if len(across) else 0.0


def _surfaces(positions: Tensor, flatness: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return the variance across (C,), the normal (C, 3) and the number of points (C,) of cells of the scan that are pieces of surfaces."""
    cell = ((positions - positions.amin(0)) / _CELL_M).long()
    size = cell.amax(0) + 1
    number = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, which, count = torch.unique(number, return_inverse=True, return_counts=True)
    weights = count.double()
    mean = positions.new_zeros((len(count), 3), dtype=torch.float64).index_add_(0, which, positions.double())
    off = positions.double() - (mean / weights[:, None])[which]
    products = (off[:, :, None] * off[:, None]).flatten(1)
    spread = products.new_zeros((len(count), 9)).index_add_(0, which, products).view(-1, 3, 3) / weights[:, None, None]
    variances, directions = torch.linalg.eigh(spread)
    # Three points always lie in a plane.
    is_surface = (count > 3) & (variances[:, 0] < flatness * variances[:, 1])
    return variances[is_surface, 0], directions[is_surface, :, 0], weights[is_surface]
