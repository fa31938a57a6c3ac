"""Directions in which histograms differ, also where most of their bins are empty."""

import torch

from core.describe.patch_descriptors import centered_roots, principal_basis


def test_a_scan_in_greys_whose_histograms_use_few_bins_has_its_directions() -> None:
    random = torch.Generator().manual_seed(0)
    histograms = torch.zeros(40, 32, 1024)
    used = torch.arange(0, 1024, 11)
    histograms[..., used] = torch.rand(40, 32, len(used), generator=random) ** 8
    roots, _ = centered_roots(histograms, torch.ones(32))
    basis = principal_basis(roots, 32, 1000)
    assert torch.allclose(basis.T @ basis, torch.eye(32), atol=1e-5)
    empty = torch.ones(1024, dtype=torch.bool)
    empty[used] = False
    assert basis[empty].abs().max() < 1e-5
    # Of the spread no other 32 directions hold more.
    flat = roots.flatten(0, 1)
    values = torch.linalg.svdvals(flat[:, used])
    assert torch.allclose((flat @ basis).square().sum(), values[:32].square().sum(), rtol=1e-4)
