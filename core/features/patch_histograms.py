"""The grid of patches on an equirectangular image, and joint histograms of the colours in each.

Paper: §3.2 (8 x 16 patches for the search, 16 x 32 for the score maps; 4 x 8 outdoors; B bins per channel per patch).
"""

from collections.abc import Sequence
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


def soft_histograms(colorings: Sequence[Tensor], weights: Tensor, patch: Tensor, num_patches: int, bins: int) -> Tensor:
    """Return normalised joint histograms (V, P, K bins³), each pixel shared trilinearly between the bins around it.

    colorings: K colours (V, S, 3) in 0..1 of the same pixels, whose histograms lie side by side; weights: (V, S) >= 0, zero where missing;
    patch: (V, S) the patch of each pixel.
    A patch without a valid pixel has the zero histogram. Deviation: a colour at the edge of a bin jumps with the least noise or change of
    light when bins are hard; the right start was first in 0.44 of the hardest shared queries with hard bins, in 0.62 with shared ones.
    """
    # Each coloring adds to its own part of the same memory: joining histograms afterwards takes as long as making them.
    histograms = weights.new_zeros((len(weights), num_patches, len(colorings), bins**3))
    flat = histograms.view(len(weights), -1)
    for number, color in enumerate(colorings):
        position = (color * bins - 0.5).clamp_(0, bins - 1)
        low = position.floor().clamp_(0, bins - 2)
        shares = position.sub_(low).unbind(-1)
        red, green, blue = low.long().unbind(-1)
        first = (patch * len(colorings) + number) * bins**3 + (red * bins + green) * bins + blue
        corners = [(first, weights)]
        for share, step in zip(shares, (bins * bins, bins, 1), strict=True):
            corners = [
                corner for at, part in corners for corner in ((at, part * (1 - share)), (at + step, part * share))
            ]
        for at, part in corners:
            flat.scatter_add_(1, at, part)
    histograms /= histograms.sum(-1, keepdim=True).clamp_min(1e-12)
    return histograms.flatten(2)
