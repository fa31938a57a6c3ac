"""Squares of the sphere, by row and by column: what is aligned patch by patch, and the chessboard that parts a picture into halves."""

import math

import torch
from torch import Tensor


def patch_numbers(directions: Tensor, side_deg: float) -> Tensor:
    """Return the number (N,) int64 of the patch, about `side_deg` degrees high and wide at the horizon, of each direction (N, 3)."""
    row, column = _squares(directions, side_deg)
    numbers: Tensor = torch.unique(row * 1000 + column, return_inverse=True)[1]
    return numbers


def on_black_squares(directions: Tensor, side_deg: float) -> Tensor:
    """Return which directions (N, 3) lie on every other square, `side_deg` degrees high and wide, as the black ones of a chessboard."""
    row, column = _squares(directions, side_deg)
    return (row + column) % 2 == 0


def _squares(directions: Tensor, side_deg: float) -> tuple[Tensor, Tensor]:
    """Return row and column (N,) of the square that each direction lies in, whole numbers."""
    x, y, z = directions.unbind(-1)
    side = math.radians(side_deg)
    row = torch.div(torch.asin(z.clamp(-1, 1)), side, rounding_mode="floor")
    # Towards the poles squares span more of the azimuth, so that they stay as wide.
    middle = ((row + 0.5) * side).cos().clamp_min(0.1)
    return row, torch.div(torch.atan2(y, x) * middle, side, rounding_mode="floor")
