"""Descriptors of views: the directions in which histograms differ, and what a map keeps of its views for photos."""

import pytest
import torch

from panoloc.core.config import FineViewConfig
from panoloc.core.features.equalization import equalize
from panoloc.core.features.fine_views import FineViewCollector, FineViews, RenderedViews
from panoloc.core.features.patch_descriptors import centered_roots, described, principal_basis
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.features.patch_histograms import described_histograms
from panoloc.core.geometry.projection import pixel_solid_angles


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


@pytest.mark.slow
def test_what_is_described_at_once_is_what_is_centred_first() -> None:
    random = torch.Generator().manual_seed(1)
    histograms = torch.rand(3, 32, 64, generator=random) * (torch.rand(3, 32, 64, generator=random) > 0.9)
    histograms[1, 4:9] = 0  # patches that show nothing
    solid = torch.rand(32, generator=random) + 0.1
    basis, _ = torch.linalg.qr(torch.randn(64, 5, generator=random))
    roots, expected = centered_roots(histograms, solid)
    values, weights = described(histograms.clone(), solid, basis)
    torch.testing.assert_close(values, roots @ basis, atol=1e-6, rtol=0)
    torch.testing.assert_close(weights, expected)
    assert not values[1, 4:9].any()
    torch.testing.assert_close((roots * weights[..., None]).sum(1), torch.zeros(3, 64), atol=1e-6, rtol=0)


def test_directions_are_those_of_the_whole_spread_whatever_the_number_of_bins() -> None:
    for bins in (8, 128, 200, 343):
        roots = torch.randn(4, 50, bins, generator=torch.Generator().manual_seed(bins)) * torch.linspace(0.1, 2, bins)
        basis = principal_basis(roots, 6, 10_000)
        flat = roots.flatten(0, 1).double()
        spread = torch.linalg.eigh(flat.T @ flat).eigenvectors[:, -6:]
        torch.testing.assert_close((basis.double().T @ spread).abs(), torch.eye(6).double(), atol=1e-4, rtol=0)


# Fine views, against the same steps taken for one view at a time.

CONFIG = FineViewConfig(patch_rows=4, patch_columns=8, size=6, picture_height=8, steps=31)
GRID, BINS, HEIGHT, WIDTH = PatchGrid(4, 8), 4, 16, 32


def rendered(count: int, seed: int, labels: bool = False) -> RenderedViews:
    """Return views of random colours, a part of each without any."""
    random = torch.Generator().manual_seed(seed)
    color = torch.rand((count, HEIGHT, WIDTH, 3), generator=random)
    valid = torch.rand((count, HEIGHT // 4, WIDTH // 4), generator=random) > 0.2
    valid = valid.repeat_interleave(4, 1).repeat_interleave(4, 2)
    weights = valid * pixel_solid_angles(HEIGHT, WIDTH)
    flat = color.flatten(1, 2)
    return RenderedViews(color, flat if labels else equalize(flat, weights.flatten(1)), valid, weights)


def roots_of(views: RenderedViews, labels: bool) -> tuple[torch.Tensor, torch.Tensor]:
    histograms = described_histograms(
        views.color, views.canonical, views.valid.float(), views.weights, GRID, BINS, labels
    )
    return centered_roots(histograms, GRID.solid_angles())


def collected(keep: list[int], labels: bool = False) -> FineViews:
    collector = FineViewCollector(CONFIG, BINS, labels, rendered(3, 0, labels))
    for seed in (1, 2):
        collector.add(rendered(3, seed, labels))
    return collector.collected(torch.tensor(keep))


@pytest.mark.slow
@pytest.mark.parametrize("labels", [False, True])
def test_descriptors_are_those_of_the_views_but_for_half_a_step(labels: bool) -> None:
    found = collected([0, 2, 4], labels)
    basis = principal_basis(roots_of(rendered(3, 0, labels), labels)[0], 6, 10_000)
    torch.testing.assert_close(found.basis, basis)
    read = found.descriptors()
    for row, (seed, number) in enumerate(((1, 0), (1, 2), (2, 1))):
        roots, weights = roots_of(rendered(3, seed, labels), labels)
        exact = roots[number] @ basis
        largest = float(exact.abs().max())
        assert float((read.values[row] - exact).abs().max()) <= largest / 62 + 1e-6
        assert float(found.scale[row]) == pytest.approx(largest / 31)
        torch.testing.assert_close(read.weights[row], weights[number], atol=1e-3, rtol=0)
    assert int(found.steps.abs().max()) == 31
    assert found.steps.dtype == torch.int8


def test_pictures_average_what_was_seen_and_leave_out_what_was_not() -> None:
    views = rendered(3, 1)
    found = collected([0, 1, 2])
    half = views.valid.view(3, 8, 2, 16, 2).float()
    color = (views.color * views.valid[..., None]).view(3, 8, 2, 16, 2, 3)
    seen = half.mean((2, 4)) >= 0.5
    assert 0 < int(seen.sum()) < seen.numel()
    assert torch.equal(found.seen, seen)
    mean = color.sum((2, 4)) / half.sum((2, 4)).clamp_min(1)[..., None]
    assert float((found.pictures.float() / 255 - mean).abs()[seen].max()) <= 0.5 / 255 + 1e-6
