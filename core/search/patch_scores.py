"""Scores of some poses by the histograms of patches."""

from torch import Tensor

from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.patch_descriptors import DescribedPatches


def patch_scores_of(
    patches: DescribedPatches, views: DescribedViews, rotations: Tensor, start: Tensor, rotation: Tensor
) -> Tensor:
    """Return the scores (K,) of some poses alone, the views numbered `start` (K,) with the rotations numbered `rotation` (K,).

    As those of `patch_scores`, without the similarity of patches that none of them puts on each other.
    """
    own = patches.values  # (Q, D)
    weighted = own * patches.weights[:, None]
    # Σ w (q · v)² over patches of the images and of the view.
    variance = (views.spreads * (own.T @ weighted)).sum((1, 2))
    towards = patches.towards(rotations)[rotation]  # (K, Q)
    met = views.steps.flatten(0, 1).index_select(0, (start[:, None] * len(patches.grid) + towards).flatten())
    met = met.view(len(start), -1).float()
    return met @ weighted.flatten() * views.scale[start] / variance[start].clamp_min(1e-18).sqrt()
