"""Patch descriptors: histograms in a form in which the whole search is one matrix product.

The Bhattacharyya similarity of two histograms is the scalar product of their square roots. Centring the similarity tensor over query
patches and view patches (so that starts that resemble everything and patches that resemble everything lose their advantage)
equals centring the descriptors of each side by their latitude-weighted mean. A basis of the map's own principal directions then keeps
32 of 512 numbers.

Paper: §3.2 uses the histogram intersection, kept in `panoloc.core.paper.intersection` and used by the `paper` method.
Deviation: on the hardest shared queries the square root lifts the right start among the first 8 from 0.93 to 0.98 at 7 ms instead
of 66 ms per 638 starts (docs/experiments.md).
"""

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.kernels.library import call, has_kernels_for

_BLOCK = 128  # columns of a symmetric product that are computed at a time
# Roots of exact zeros take eight times as long on a CPU, and most bins are empty. This one's root is below what single precision keeps of
# others. Centred, rounding alone is left of it, and products of that must not be denormal, which take twenty times as long.
_LEAST = 1e-20
_ORDER = 1e-12  # of the largest spread, over all bins: far below what single precision keeps


@dataclass(frozen=True)
class ViewDescriptors:
    """Descriptors of all views of a map.

    values: (T, P, D) float32, centred per view, zero for patches without a pixel. basis: (bins³, D) float32.
    weights: (T, P) float32, solid-angle share of each valid patch, summing to one per view. spreads: (T, D, D), as of `spreads_of`.
    """

    values: Tensor
    basis: Tensor
    weights: Tensor
    spreads: Tensor

    def take(self, keep: Tensor) -> "ViewDescriptors":
        """Return the descriptors of the views numbered `keep`."""
        if len(keep) == len(self.values):
            return self
        return ViewDescriptors(self.values[keep], self.basis, self.weights[keep], self.spreads[keep])


def spreads_of(values: Tensor, weights: Tensor) -> Tensor:
    """Return how the descriptors (T, P, D) of each view spread, (T, D, D): Σ w v vᵀ over its patches, of weights (T, P)."""
    return (values * weights[..., None]).mT @ values


def centered_roots(histograms: Tensor, solid_angles: Tensor, basis: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return square roots (V, P, bins³) centred per view over valid patches, and the patches' weights (V, P), summing to one.

    basis: (bins³, D); roots along it alone, (V, P, D), take a third of the time, for what is centred afterwards is a thirtieth as large.
    The histograms are used up: their roots take their place.
    """
    weights = solid_angles * (histograms.sum(-1) > 0)
    weights = weights / weights.sum(-1, keepdim=True).clamp_min(1e-12)
    roots = histograms.clamp_min_(_LEAST).sqrt_()
    values = roots if basis is None else roots @ basis
    mean = (values * weights[..., None]).sum(1, keepdim=True)
    return (values - mean) * (weights > 0)[..., None], weights


def principal_basis(roots: Tensor, size: int) -> Tensor:
    """Return the (bins³, size) orthonormal directions along which centred roots (V, P, bins³) vary most."""
    # Solved in double precision: bins that no patch uses make the matrix singular, and single precision then returns NaN at times.
    spread = _products(roots.flatten(0, 1)).double()
    # Of a scan in greys nine in ten bins are empty: of so many equal eigenvalues the solver finds no order, unless each gets one.
    order = torch.linspace(
        0, _ORDER * float(spread.diagonal().max()), len(spread), dtype=spread.dtype, device=spread.device
    )
    vectors: Tensor = torch.linalg.eigh(spread + order.diag()).eigenvectors
    return vectors[:, -size:].float().contiguous()


def _products(rows: Tensor) -> Tensor:
    """Return rows.T @ rows, little more than half of it computed: the rest is its mirror image."""
    upper = rows.new_zeros(rows.shape[1], rows.shape[1])
    for first in range(0, rows.shape[1], _BLOCK):
        upper[first : first + _BLOCK, first:] = rows[:, first : first + _BLOCK].T @ rows[:, first:]
    return upper.triu() + upper.triu(1).T


def pooled(values: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return descriptors (V, P / 4, D) and weights (V, P / 4) with squares of 2 x 2 patches taken together.

    values: (V, P, D) and weights: (V, P) on a grid of twice as many columns as rows, both numbers even.
    """
    num_views, num_patches, size = values.shape
    rows = math.isqrt(num_patches // 2)
    squares = (num_views, rows // 2, 2, rows, 2)
    parts, shares = values.view(*squares, size), weights.view(squares)
    total = shares.sum((2, 4))
    shares = shares / total.clamp_min(1e-9)[:, :, None, :, None]
    mean = values.new_zeros((*total.shape, size))
    # Added up patch by patch: sums over two axes take several times as long.
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        mean.addcmul_(parts[:, :, row, :, column], shares[:, :, row, :, column, None])
    return mean.flatten(1, 2), total.flatten(1)


@dataclass(frozen=True)
class DescribedPatches:
    """Patches of a rig: values (Q, D), their numbers on `grid` (Q,), and weights (Q,) that sum to one.

    known: what `towards` has found for the same patches in other maps.
    """

    values: Tensor
    numbers: Tensor
    weights: Tensor
    grid: PatchGrid
    known: dict[int, tuple[Tensor, Tensor]] = field(default_factory=dict)

    def towards(self, rotations: Tensor) -> Tensor:
        """Return the patch (R, Q) of a view that each patch lies on under rotations (R, 3, 3) map_from_rig (paper, Eq. 1)."""
        of, met = self.known.get(id(rotations), (None, None))
        if of is not rotations or met is None:
            centers = self.grid.centers(rotations.device)[self.numbers]
            met = self.grid.patch_of_direction(torch.einsum("rab,qb->rqa", rotations, centers))
            self.known[id(rotations)] = rotations, met
        return met


def patch_scores(patches: DescribedPatches, views: ViewDescriptors, rotations: Tensor) -> Tensor:
    """Return the scores (T, R) of all views with rotations (R, 3, 3) map_from_rig: Σ_i weight_i · I[t, i, π_r(i)].

    I is divided by its weighted standard deviation per view, so that scores are comparable between views: the score of a pose says how much
    better this alignment is than a random pairing of the same patches.
    """
    num_views, num_patches, size = views.values.shape
    weighted = patches.values * patches.weights[:, None]
    # In memory the start comes last, so that the gather reads whole rows and nothing has to be copied.
    rows = (weighted @ views.values.transpose(0, 1).reshape(-1, size).T).view(-1, num_views)
    first = torch.arange(len(weighted), device=rotations.device) * num_patches
    met = patches.towards(rotations) + first
    if has_kernels_for(rows):
        sums = rows.new_empty((len(rotations), num_views))
        call("sums_of_patches", rows, len(rows), num_views, met, *met.shape, sums)
    else:
        sums = torch.nn.functional.embedding_bag(met, rows, mode="sum")
    # Σ w (q · v)² over patches of the images and of the view.
    deviation = (views.spreads * (patches.values.T @ weighted)).sum((1, 2)).clamp_min(0).sqrt().clamp_min(1e-9)
    return (sums / deviation).T
