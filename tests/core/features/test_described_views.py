"""What a map keeps of its views, against the same steps taken for one view at a time."""

from dataclasses import fields

import pytest
import torch

from panoloc.core.config import DescriptorConfig
from panoloc.core.features.described_views import DescribedViews, ViewCollector, described_histograms
from panoloc.core.features.patch_descriptors import centered_roots, principal_basis
from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.geometry.projection import pixel_solid_angles

CONFIG = DescriptorConfig(view_height=32, bins=4, size=6, steps=31)
GRID, HEIGHT, WIDTH = PatchGrid(8, 16), 32, 64


def rendered(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return colours and weights of views of random colours, a part of each without any."""
    random = torch.Generator().manual_seed(seed)
    color = torch.rand((count, HEIGHT, WIDTH, 3), generator=random)
    patches = torch.rand((count, HEIGHT // 4, WIDTH // 4), generator=random) > 0.2
    quarters = torch.rand((count, HEIGHT // 2, WIDTH // 2), generator=random) > 0.4
    valid = patches.repeat_interleave(4, 1).repeat_interleave(4, 2)
    valid &= quarters.repeat_interleave(2, 1).repeat_interleave(2, 2)
    return color, valid * pixel_solid_angles(HEIGHT, WIDTH)


def roots_of(views: tuple[torch.Tensor, torch.Tensor], labels: bool) -> tuple[torch.Tensor, torch.Tensor]:
    histograms = described_histograms(*views, GRID, CONFIG.bins, labels)
    return centered_roots(histograms, GRID.solid_angles())


def collected(keep: list[int], labels: bool = False) -> DescribedViews:
    collector = ViewCollector(CONFIG, labels, *rendered(3, 0))
    for seed in (1, 2):
        collector.add(*rendered(3, seed))
    return collector.collected(torch.tensor(keep))


@pytest.mark.parametrize("labels", [False, True])
def test_descriptors_are_those_of_the_views_but_for_half_a_step(labels: bool) -> None:
    found = collected([0, 2, 4], labels)
    basis = principal_basis(roots_of(rendered(3, 0), labels)[0], 6)
    torch.testing.assert_close(found.basis, basis)
    read = found.descriptors()
    for row, (seed, number) in enumerate(((1, 0), (1, 2), (2, 1))):
        roots, weights = roots_of(rendered(3, seed), labels)
        exact = roots[number] @ basis
        largest = float(exact.abs().max())
        assert float((read.values[row] - exact).abs().max()) <= largest / 62 + 1e-6
        assert float(found.scale[row]) == pytest.approx(largest / 31)
        torch.testing.assert_close(read.weights[row], weights[number], atol=1e-3, rtol=0)
    assert int(found.steps.abs().max()) == 31
    assert found.steps.dtype == torch.int8


def test_patches_taken_together_are_those_of_the_coarser_grid() -> None:
    """By the centre of each patch."""
    views = collected([0, 1, 2, 3, 5])
    assert views.grid == GRID
    fine = views.descriptors()
    for halvings in (1, 2):
        coarse, found = GRID.halved(halvings), views.descriptors(halvings)
        assert coarse == PatchGrid(8 // 2**halvings, 16 // 2**halvings)
        member = torch.nn.functional.one_hot(coarse.patch_of_direction(GRID.centers()), len(coarse)).float()
        weights = fine.weights @ member
        means = torch.einsum("tpd,tp,pc->tcd", fine.values, fine.weights, member)
        torch.testing.assert_close(found.weights, weights, atol=1e-6, rtol=1e-5)
        torch.testing.assert_close(found.values, means / weights.clamp_min(1e-9)[..., None], atol=1e-5, rtol=1e-4)
        # Still centred, so that no patch that resembles everything has an advantage.
        assert float((found.values * found.weights[..., None]).sum(1).abs().max()) < 5e-3 * float(
            fine.values.abs().max()
        )
        assert views.descriptors(halvings) is found


def test_the_spread_of_a_view_is_that_of_the_descriptors_of_its_patches() -> None:
    views = collected([4, 1])
    read = views.descriptors()
    for view in range(2):
        expected = sum(
            weight * torch.outer(value, value)
            for weight, value in zip(read.weights[view], read.values[view], strict=True)
        )
        torch.testing.assert_close(views.spreads[view], expected)


def test_the_memory_of_views_is_that_of_what_they_hold_once_they_were_searched() -> None:
    views = collected([0, 1, 2, 3, 4, 5])
    counted = views.num_bytes
    held = [getattr(views, field.name) for field in fields(views)]
    held += [views.spreads, *(views.descriptors(halvings).values for halvings in (1, 2))]
    assert counted == sum(tensor.numel() * tensor.element_size() for tensor in held)


def test_pictures_average_what_was_seen_and_leave_out_what_was_not() -> None:
    shown, weights = rendered(3, 1)
    found = collected([0, 1, 2])
    half = (weights > 0).view(3, 16, 2, 32, 2).float()
    color = (shown * (weights > 0)[..., None]).view(3, 16, 2, 32, 2, 3)
    seen = half.mean((2, 4)) >= 0.5
    assert 0 < int(seen.sum()) < seen.numel()
    assert torch.equal(found.seen, seen)
    mean = color.sum((2, 4)) / half.sum((2, 4)).clamp_min(1)[..., None]
    assert float((found.pictures.float() / 255 - mean).abs()[seen].max()) <= 0.5 / 255 + 1e-6
