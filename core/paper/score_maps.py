"""The paper's score maps: which patches of the panorama, and which points of the scan, find a match anywhere.

Paper: §3.2, Eq. 2 (2D) and Eq. 3 (3D). Both are reductions of the intersection tensor.
"""

import torch
from torch import Tensor

from panoloc.core.features.patch_histograms import PatchGrid


def score_map_2d(tensor: Tensor, table: Tensor) -> Tensor:
    """Return M (P,): for each query patch the largest Λ over all views and all rotations (Eq. 2).

    tensor: I (T, P, P). table: π (R, P). Only patches that some rotation brings together count.
    """
    reachable = pairing_counts(table) > 0
    best = tensor.amax(0)
    return torch.where(reachable, best, torch.full_like(best, -1.0)).amax(1)


def view_patch_scores(tensor: Tensor, table: Tensor) -> Tensor:
    """Return B (T, P): for each view patch the mean Λ with the query patches that the rotations bring onto it (Eq. 3, inner part)."""
    counts = pairing_counts(table).to(tensor.dtype)
    share = counts / counts.sum(0, keepdim=True).clamp_min(1)
    return (tensor * share).sum(1)


def score_map_3d(
    patch_scores: Tensor, positions: Tensor, starts: Tensor, grid: PatchGrid, chunk: int = 1_000_000
) -> Tensor:
    """Return M_3D (N,): for each point the mean over views of the score of the patch that it projects to (Eq. 3).

    patch_scores: B (T, P). positions: (N, 3) metres. starts: (T, 3) metres, where the views were rendered.
    """
    total = torch.zeros(len(positions), device=positions.device)
    for scores, start in zip(patch_scores, starts, strict=True):
        for first in range(0, len(positions), chunk):
            part = positions[first : first + chunk]
            total[first : first + chunk] += scores[grid.patch_of_direction(part - start)]
    return total / len(starts)


def pairing_counts(table: Tensor) -> Tensor:
    """Return (P, P) int64: how many of the rotations bring query patch i (row) onto view patch j (column)."""
    num_patches = table.shape[1]
    pair = table + torch.arange(num_patches, device=table.device) * num_patches
    return torch.bincount(pair.flatten(), minlength=num_patches**2).view(num_patches, num_patches)


def sample_patch_map(scores: Tensor, grid: PatchGrid, points: Tensor) -> Tensor:
    """Return the patch score (N,) of the direction of camera-frame points (N, 3): S_2D = Γ(Π(RX + t); M_2D) (Eq. 5)."""
    return scores[grid.patch_of_direction(points)]
