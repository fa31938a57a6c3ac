"""Descriptors of patches: the directions in which histograms differ, and patches taken together."""

import numpy as np
import pytest
import torch

from panoloc.core.features.patch_descriptors import centered_roots, pooled, principal_basis


def test_a_scan_in_greys_whose_histograms_use_few_bins_has_its_directions() -> None:
    random = torch.Generator().manual_seed(0)
    histograms = torch.zeros(40, 32, 1024)
    used = torch.arange(0, 1024, 11)
    histograms[..., used] = torch.rand(40, 32, len(used), generator=random) ** 8
    roots, _ = centered_roots(histograms, torch.ones(32))
    basis = principal_basis(roots, 32)
    assert torch.allclose(basis.T @ basis, torch.eye(32), atol=1e-5)
    empty = torch.ones(1024, dtype=torch.bool)
    empty[used] = False
    assert basis[empty].abs().max() < 1e-5
    # Of the spread no other 32 directions hold more.
    flat = roots.flatten(0, 1)
    values = torch.linalg.svdvals(flat[:, used])
    assert torch.allclose((flat @ basis).square().sum(), values[:32].square().sum(), rtol=1e-4)


def test_no_product_of_what_is_left_of_empty_bins_is_denormal() -> None:
    random = torch.Generator().manual_seed(2)
    histograms = torch.rand(20, 128, 512, generator=random) * (torch.arange(512) % 9 == 0)
    histograms[torch.rand(20, 128, generator=random) < 0.2] = 0  # patches that show nothing: weights differ by view
    roots, _ = centered_roots(histograms, torch.rand(128, generator=random) + 0.1)
    left = roots[roots != 0].abs().min()
    assert 0 < left < 1e-9
    assert float(left) ** 2 > torch.finfo(torch.float32).tiny


@pytest.mark.slow
def test_what_is_described_at_once_is_what_is_centred_first() -> None:
    random = torch.Generator().manual_seed(1)
    histograms = torch.rand(3, 32, 64, generator=random) * (torch.rand(3, 32, 64, generator=random) > 0.9)
    histograms[1, 4:9] = 0  # patches that show nothing
    solid = torch.rand(32, generator=random) + 0.1
    basis, _ = torch.linalg.qr(torch.randn(64, 5, generator=random))
    roots, expected = centered_roots(histograms.clone(), solid)
    values, weights = centered_roots(histograms.clone(), solid, basis)
    torch.testing.assert_close(values, roots @ basis, atol=1e-6, rtol=0)
    torch.testing.assert_close(weights, expected)
    assert not values[1, 4:9].any()
    torch.testing.assert_close((roots * weights[..., None]).sum(1), torch.zeros(3, 64), atol=1e-6, rtol=0)


def test_directions_are_those_of_the_whole_spread_whatever_the_number_of_bins() -> None:
    for bins in (8, 128, 200, 343):
        roots = torch.randn(4, 50, bins, generator=torch.Generator().manual_seed(bins)) * torch.linspace(0.1, 2, bins)
        basis = principal_basis(roots, 6)
        flat = roots.flatten(0, 1).double()
        spread = torch.linalg.eigh(flat.T @ flat).eigenvectors[:, -6:]
        torch.testing.assert_close((basis.double().T @ spread).abs(), torch.eye(6).double(), atol=1e-4, rtol=0)


def test_patches_taken_together_have_the_weighted_mean_of_the_four_and_their_weight() -> None:
    rng = np.random.default_rng(2)
    values, weights = rng.normal(size=(3, 32, 5)), rng.uniform(size=(3, 32)) * (rng.uniform(size=(3, 32)) < 0.6)
    weights[1, [0, 1, 8, 9]] = 0.0  # a square of which nothing was seen
    found, total = (each.numpy() for each in pooled(torch.from_numpy(values), torch.from_numpy(weights)))
    assert found.shape == (3, 8, 5)
    for view, row, column in np.ndindex(3, 2, 4):
        four = [8 * (2 * row + down) + 2 * column + across for down, across in np.ndindex(2, 2)]
        mass = weights[view, four].sum()
        expected = sum(weights[view, one] * values[view, one] for one in four) / max(mass, 1e-9)
        np.testing.assert_allclose(found[view, 4 * row + column], expected, atol=1e-9)
        assert total[view, 4 * row + column] == pytest.approx(mass)
