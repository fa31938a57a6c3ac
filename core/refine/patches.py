"""Patches of the sphere: what is aligned patch by patch, sums over the points of each, and the chessboard of two halves."""

import math
from functools import cached_property

import numpy as np
import torch
from torch import Tensor


class PatchSums:
    """Sums over patches of N points, which lie one patch after the other."""

    def __init__(self, patches: Tensor) -> None:
        """patches: (N,) int64, ascending, each from 0 to P − 1 at least once."""
        # To look would make a GPU wait.
        ascend = patches.device.type != "cpu" or bool((patches.diff() >= 0).all())
        assert ascend, "points of one patch must follow each other"
        self.patches = patches

    @cached_property
    def starts(self) -> Tensor:
        """Return the number (P + 1,) int64 of the first point of each patch, and N."""
        numbers = torch.arange(int(self.patches[-1]) + 2, device=self.patches.device)
        return torch.searchsorted(self.patches, numbers)

    @cached_property
    def _members(self) -> Tensor:
        """Return who is where, (N, P), 1 or 0."""
        return torch.nn.functional.one_hot(self.patches).float()

    def __call__(self, values: Tensor) -> Tensor:
        """Return the sums (..., P) of values (..., N)."""
        if self.patches.device.type == "cpu":
            # One patch after the other: of six photos, which show 150, a twentieth of the time of the product.
            return torch.from_numpy(np.add.reduceat(values.numpy(), self.starts[:-1].numpy(), axis=-1))
        # So many operations for each point as there are patches, which a GPU has to spare.
        return values @ self._members

    def spread(self, values: Tensor) -> Tensor:
        """Return values of patches (..., P) as those of their points (..., N)."""
        return values[..., self.patches]


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
