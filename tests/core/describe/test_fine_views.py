"""What a map keeps of its views for photos, against the same steps taken for one view at a time."""

import pytest
import torch

from panoloc.core.config import FineViewConfig
from panoloc.core.describe.fine_views import FineViewCollector, FineViews, RenderedViews
from panoloc.core.describe.patch_descriptors import centered_roots, principal_basis
from panoloc.core.describe.patch_histograms import described_histograms
from panoloc.core.describe.spherical_patches import PatchGrid
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.light.color_equalization import equalize

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
