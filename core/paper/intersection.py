"""Histograms of patches, and the intersection tensor: all query patches against all patches of all views, by intersection Λ.

Paper: §3.2 (B bins per channel per patch). Everything the `paper` method's search needs is a reduction of this one tensor (docs/method.md).
"""

import torch
from torch import Tensor

from panoloc.core.features.patch_histograms import PatchGrid


def hard_histograms(color: Tensor, weights: Tensor, patch: Tensor, num_patches: int, bins: int) -> Tensor:
    """Return normalised joint histograms (V, P, bins³), each pixel in the one bin it falls into; arguments as of `soft_histograms`."""
    cell = (color * bins).long().clamp_(0, bins - 1)
    index = (cell[..., 0] * bins + cell[..., 1]) * bins + cell[..., 2]
    histogram = torch.zeros((len(color), num_patches * bins**3), device=color.device)
    histogram = histogram.scatter_add_(1, patch * bins**3 + index, weights).view(len(color), num_patches, -1)
    return histogram / histogram.sum(-1, keepdim=True).clamp_min(1e-12)


def rotation_table(grid: PatchGrid, rotations: Tensor) -> Tensor:
    """Return π (R, P) int64: which view patch meets query patch i when the camera has rotation r (paper, §3.1, Eq. 1).

    rotations: (R, 3, 3), map_from_camera. Query patch i looks along R c_i in the map frame, where the view rendered without
    rotation has the patch whose centre is nearest to Π(R c_i).
    """
    return grid.patch_of_direction(torch.einsum("rab,pb->rpa", rotations, grid.centers(rotations.device)))


def bin_major(histograms: Tensor) -> Tensor:
    """Return histograms (T, P, B) as (B, P T), contiguous: the layout in which one query bin reads one row."""
    return histograms.permute(2, 1, 0).flatten(1).contiguous()


def intersection_tensor(query: Tensor, views: Tensor, num_views: int) -> Tensor:
    """Return I (T, P, P'): Λ of query patch i (second axis) and view patch j (third axis), Λ(a, b) = Σ min(a, b).

    query: (P, B) normalised histograms. views: (B, P' T) from `bin_major`. Only the bins that a query patch
    occupies can contribute, about 12 of 512.
    """
    rows = []
    for histogram in query:
        occupied = histogram.nonzero()[:, 0]
        rows.append(torch.minimum(views[occupied], histogram[occupied, None]).sum(0))
    return torch.stack(rows).view(len(query), -1, num_views).permute(2, 0, 1)
