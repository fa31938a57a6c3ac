"""The grid of patches on an equirectangular image over which colour histograms are taken.

Paper: §3.2 (8 x 16 patches for the search, 16 x 32 for the score maps; 4 x 8 outdoors).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles, project


@dataclass(frozen=True)
class PatchGrid:
    """Equal steps of azimuth and elevation: `rows` x `columns` patches, numbered row by row."""

    rows: int
    columns: int

    def __len__(self) -> int:
        return self.rows * self.columns

    def halved(self, halvings: int) -> "PatchGrid":
        """Return the grid of patches that are taken together in squares of 2 ^ `halvings` a side."""
        return PatchGrid(self.rows >> halvings, self.columns >> halvings)

    def centers(self, device: torch.device | str = "cpu") -> Tensor:
        """Return the unit viewing directions (P, 3) of the patch centres."""
        return pixel_directions(self.rows, self.columns, device).flatten(0, 1)

    def solid_angles(self, device: torch.device | str = "cpu") -> Tensor:
        """Return the solid angles (P,) in steradians."""
        return pixel_solid_angles(self.rows, self.columns, device).expand(-1, self.columns).flatten()

    def patch_of_direction(self, directions: Tensor) -> Tensor:
        """Return the patch number (...) that each direction (..., 3) falls into, by Π: that of the nearest centre (paper, Eq. 1)."""
        u, v = project(directions, self.rows, self.columns)
        row = v.floor().clamp(0, self.rows - 1).long()
        return row * self.columns + u.floor().clamp(0, self.columns - 1).long()

    def patch_of_pixel(self, height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
        """Return the patch number (H, W) of every pixel of an image."""
        row = (torch.arange(height, device=device) * self.rows) // height
        column = (torch.arange(width, device=device) * self.columns) // width
        return row[:, None] * self.columns + column
