"""Scores of poses by the histograms of patches of 11 degrees, which say what colours are where, and not how they lie."""

import torch
from torch import Tensor

from panoloc.core.features.fine_views import FineViews
from panoloc.core.features.patch_descriptors import ViewDescriptors, similarity_tensor
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.search.described_photos import DescribedPhotos


def patch_scores(photos: DescribedPhotos, views: ViewDescriptors, rotations: Tensor, grid: PatchGrid) -> Tensor:
    """Return the scores (T, R) of all views with rotations (R, 3, 3)."""
    num_views, num_patches, _ = views.values.shape
    tensor = similarity_tensor(photos.roots @ views.basis, views.values).permute(1, 2, 0)  # (Q, P, T)
    spread = (tensor.square() * photos.weights[:, None, None]).sum(0) * views.weights.T
    deviation = spread.sum(0).sqrt().clamp_min(1e-9)
    rows = (tensor / deviation).reshape(-1, num_views)
    meets = _met_patches(photos, rotations, grid)
    meets = meets + torch.arange(len(photos.patches), device=rotations.device) * num_patches
    weights = photos.weights.expand(len(rotations), -1).contiguous()
    return torch.nn.functional.embedding_bag(meets, rows, mode="sum", per_sample_weights=weights).T


def patch_scores_of(
    photos: DescribedPhotos, views: FineViews, rotations: Tensor, start: Tensor, rotation: Tensor, grid: PatchGrid
) -> Tensor:
    """Return the scores (K,) of some poses alone, the views numbered `start` (K,) with the rotations numbered `rotation` (K,).

    As those of `patch_scores`, without the similarity of patches that none of them puts on each other.
    """
    own = photos.roots @ views.basis  # (Q, D)
    weighted = own * photos.weights[:, None]
    # Σ w (q · v)² over patches of the photos and of the view.
    variance = (views.spreads * (own.T @ weighted)).sum((1, 2))
    towards = _met_patches(photos, rotations, grid)[rotation]  # (K, Q)
    met = views.steps.flatten(0, 1).index_select(0, (start[:, None] * len(grid) + towards).flatten())
    met = met.view(len(start), -1).float()
    return met @ weighted.flatten() * views.scale[start] / variance[start].clamp_min(1e-18).sqrt()


def _met_patches(photos: DescribedPhotos, rotations: Tensor, grid: PatchGrid) -> Tensor:
    """Return the patch (R, Q) of a view that each patch of the photos lies on."""
    towards = torch.einsum("rab,qb->rqa", rotations, grid.centers(rotations.device)[photos.patches])
    return grid.nearest_patch(towards)
