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
from dataclasses import dataclass

import torch
from torch import Tensor

_BLOCK = 128  # columns of a symmetric product that are computed at a time
# Roots of exact zeros take eight times as long on a CPU, and most bins are empty; its root is below what single precision keeps.
_LEAST = 1e-30
_ORDER = 1e-12  # of the largest spread, over all bins: far below what single precision keeps


@dataclass(frozen=True)
class ViewDescriptors:
    """Descriptors of all views of a map.

    values: (T, P, D) float32, centred per view, zero for patches without a pixel. basis: (bins³, D) float32.
    weights: (T, P) float32, solid-angle share of each valid patch, summing to one per view.
    """

    values: Tensor
    basis: Tensor
    weights: Tensor


def centered_roots(histograms: Tensor, solid_angles: Tensor) -> tuple[Tensor, Tensor]:
    """Return square roots (V, P, bins³) centred per view over valid patches, and the patches' weights (V, P), summing to one."""
    weights = _weights(histograms, solid_angles)
    return _centered(histograms.clamp_min(_LEAST).sqrt_(), weights), weights


def described(histograms: Tensor, solid_angles: Tensor, basis: Tensor) -> tuple[Tensor, Tensor]:
    """Return centred roots along `basis` (bins³, D), (V, P, D), and the patches' weights (V, P), summing to one.

    As `centered_roots(...)[0] @ basis`, in a third of the time: what is centred afterwards is a thirtieth as large. The histograms are used
    up: their roots take their place.
    """
    weights = _weights(histograms, solid_angles)
    return _centered(histograms.clamp_min_(_LEAST).sqrt_() @ basis, weights), weights


def _weights(histograms: Tensor, solid_angles: Tensor) -> Tensor:
    weights = solid_angles * (histograms.sum(-1) > 0)
    return weights / weights.sum(-1, keepdim=True).clamp_min(1e-12)


def _centered(values: Tensor, weights: Tensor) -> Tensor:
    mean = (values * weights[..., None]).sum(1, keepdim=True)
    return (values - mean) * (weights > 0)[..., None]


def principal_basis(roots: Tensor, size: int, sample: int) -> Tensor:
    """Return the (bins³, size) orthonormal directions along which centred roots (V, P, bins³) vary most, told from `sample` patches."""
    flat = roots.flatten(0, 1)
    flat = flat[:: max(1, len(flat) // sample)]
    # Solved in double precision: bins that no patch uses make the matrix singular, and single precision then returns NaN at times.
    spread = _products(flat).double()
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
    total = weights.view(squares).sum((2, 4)).flatten(1)
    mean = (values * weights[..., None]).view(*squares, size).sum((2, 4)).flatten(1, 2)
    return mean / total.clamp_min(1e-9)[..., None], total


def similarity_tensor(query: Tensor, views: Tensor) -> Tensor:
    """Return the centred similarity I (T, P, P) of query patches (P, D) (first) and view patches (T, P, D) (second).

    In memory the start comes last, so that the gather of `panoloc.core.search.pose_scores` reads whole rows and nothing
    has to be copied.
    """
    num_views, num_patches, size = views.shape
    product = query @ views.transpose(0, 1).reshape(-1, size).T
    return product.view(len(query), num_patches, num_views).permute(2, 0, 1)


def normalize_per_view(tensor: Tensor, query_weights: Tensor, view_weights: Tensor) -> Tensor:
    """Divide I (T, P, P) by its weighted standard deviation per view, so that scores are comparable between views.

    The score of a pose then says how much better this alignment is than a random pairing of the same patches.
    """
    num_views, num_patches, _ = tensor.shape
    squares = tensor.square().permute(1, 2, 0).reshape(num_patches, -1)
    per_view_patch = (query_weights @ squares).view(-1, num_views)
    deviation = (per_view_patch * view_weights.T).sum(0).sqrt().clamp_min(1e-9)
    return tensor / deviation[:, None, None]
