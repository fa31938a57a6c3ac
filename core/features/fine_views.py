"""Fine views: what a map keeps of its views for photos.

A photo of a phone shows eight patches of 22 degrees: too few to tell places apart. Patches of 11 degrees propose poses, and a small picture
of each view lets thousands of them be scored again by what is inside of patches, which histograms cannot know (docs/experiments.md).
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.config import FineViewConfig
from panoloc.core.features.patch_descriptors import ViewDescriptors, centered_roots, described, principal_basis
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.features.patch_histograms import described_histograms

_VIEWS_AT_ONCE = 256


@dataclass(frozen=True)
class FineViews:
    """Descriptors and pictures of T views.

    steps: (T, P, D) int8, descriptors in steps of `scale` (T,) float32. basis: (B, D) float32. weights: (T, P) float16, solid-angle share
    of each valid patch. pictures: (T, h, 2h, 3) uint8, what was rendered; seen: (T, h, 2h) bool, where anything was.
    """

    steps: Tensor
    scale: Tensor
    basis: Tensor
    weights: Tensor
    pictures: Tensor
    seen: Tensor

    def descriptors(self) -> ViewDescriptors:
        """Return the descriptors as numbers."""
        values = self.steps.float() * self.scale[:, None, None]
        return ViewDescriptors(values, self.basis, self.weights.float())

    @cached_property
    def spreads(self) -> Tensor:
        """Return how the descriptors of each view spread, (T, D, D): Σ w v vᵀ over its patches."""
        parts = []
        with torch.inference_mode(False):  # they outlive the query that asked for them first
            for first in range(0, len(self.steps), _VIEWS_AT_ONCE):
                some = self.take(
                    torch.arange(first, min(first + _VIEWS_AT_ONCE, len(self.steps)), device=self.scale.device)
                )
                described = some.descriptors()
                parts.append((described.values * described.weights[..., None]).mT @ described.values)
        return torch.cat(parts)

    def take(self, keep: Tensor) -> "FineViews":
        """Return the views numbered `keep`."""
        return FineViews(
            self.steps[keep], self.scale[keep], self.basis, self.weights[keep], self.pictures[keep], self.seen[keep]
        )

    def to(self, device: torch.device | str) -> "FineViews":
        """Return the views on `device`."""
        tensors = (self.steps, self.scale, self.basis, self.weights, self.pictures, self.seen)
        return FineViews(*(tensor.to(device) for tensor in tensors))

    @property
    def num_bytes(self) -> int:
        """Return the memory of all arrays."""
        tensors = (self.steps, self.scale, self.basis, self.weights, self.pictures, self.seen)
        return sum(tensor.numel() * tensor.element_size() for tensor in tensors)


@dataclass(frozen=True)
class RenderedViews:
    """Views of a batch: color (B, H, W, 3) in 0..1, canonical (B, H W, 3), valid (B, H, W) bool, weights (B, H, W) solid angles."""

    color: Tensor
    canonical: Tensor
    valid: Tensor
    weights: Tensor


class FineViewCollector:
    """Describes views batch by batch. The basis comes from views that lie evenly among all, given first."""

    def __init__(self, config: FineViewConfig, bins: int, is_labels: bool, sample: RenderedViews) -> None:
        self._config, self._bins, self._is_labels = config, bins, is_labels
        self._grid = PatchGrid(config.patch_rows, config.patch_columns)
        self._solid_angles = self._grid.solid_angles(sample.color.device)
        roots, _ = centered_roots(self._histograms(sample), self._solid_angles)
        self._basis = principal_basis(roots, config.size, roots.shape[0] * roots.shape[1])
        self._parts: list[FineViews] = []

    def add(self, views: RenderedViews) -> None:
        """Describe a batch."""
        values, weights = described(self._histograms(views), self._solid_angles, self._basis)
        scale = values.abs().amax((1, 2)).clamp_min(1e-9) / self._config.steps
        steps = (values / scale[:, None, None]).round().to(torch.int8)
        pictures, seen = small_pictures(views, self._config.picture_height)
        self._parts.append(FineViews(steps, scale, self._basis, weights.half(), pictures, seen))

    def collected(self, keep: Tensor) -> FineViews:
        """Return the views numbered `keep` of all that were added."""
        names = ("steps", "scale", "weights", "pictures", "seen")
        joined = {name: torch.cat([getattr(part, name) for part in self._parts]) for name in names}
        return FineViews(**joined, basis=self._basis).take(keep)

    def _histograms(self, views: RenderedViews) -> Tensor:
        return histograms_of_views(views, self._grid, self._bins, self._is_labels)


def histograms_of_views(views: RenderedViews, grid: PatchGrid, bins: int, is_labels: bool) -> Tensor:
    """Return the histograms (B, P, bins³ or twice as many) of the patches of views."""
    return described_histograms(views.color, views.canonical, views.valid.float(), views.weights, grid, bins, is_labels)


def small_pictures(views: RenderedViews, height: int) -> tuple[Tensor, Tensor]:
    """Return pictures (B, h, 2h, 3) uint8 averaged over what was seen, and where at least half was (B, h, 2h)."""
    planes = torch.cat((views.color * views.valid[..., None], views.valid[..., None].float()), dim=-1).permute(
        0, 3, 1, 2
    )
    small = torch.nn.functional.interpolate(planes, size=(height, 2 * height), mode="area")
    color = small[:, :3] / small[:, 3:].clamp_min(1e-6)
    return (color.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).contiguous(), small[:, 3] >= 0.5
