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

    def polar_sines(self, device: torch.device | str = "cpu") -> Tensor:
        """Return S (P,): the sine of the polar angle of each centre, the share of a full-width row (paper, supplement)."""
        x, y, _ = self.centers(device).unbind(-1)
        return torch.hypot(x, y)

    def solid_angles(self, device: torch.device | str = "cpu") -> Tensor:
        """Return the solid angles (P,) in steradians."""
        return pixel_solid_angles(self.rows, self.columns, device).expand(-1, self.columns).flatten()

    def patch_of_direction(self, directions: Tensor) -> Tensor:
        """Return the patch number (...) that each direction (..., 3) falls into: the grid cell, by Π."""
        u, v = project(directions, self.rows, self.columns)
        row = v.floor().clamp(0, self.rows - 1).long()
        return row * self.columns + u.floor().clamp(0, self.columns - 1).long()

    def patch_of_pixel(self, height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
        """Return the patch number (H, W) of every pixel of an image."""
        row = (torch.arange(height, device=device) * self.rows) // height
        column = (torch.arange(width, device=device) * self.columns) // width
        return row[:, None] * self.columns + column

    def nearest_patch(self, directions: Tensor) -> Tensor:
        """Return the patch (...) whose centre is nearest in the image plane to Π(direction), argmin_c ‖c − p‖ (paper, Eq. 1).

        In a regular grid the nearest centre is the centre of the cell.
        """
        return self.patch_of_direction(directions)


def rotation_table(grid: PatchGrid, rotations: Tensor) -> Tensor:
    """Return π (R, P) int64: which view patch meets query patch i when the camera has rotation r (paper, §3.1, Eq. 1).

    rotations: (R, 3, 3), map_from_camera. Query patch i looks along R c_i in the map frame, where the view rendered without
    rotation has the patch nearest to Π(R c_i).
    """
    directions = torch.einsum("rab,pb->rpa", rotations, grid.centers(rotations.device))
    return grid.nearest_patch(directions)
