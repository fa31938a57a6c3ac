"""What a map keeps of its synthetic views: descriptors of patches, and small pictures.

Patches of 11 degrees propose poses of a photo; taken together two by two, those of a panorama. A small picture of each view lets thousands
of poses be scored again by what is inside of patches, which histograms cannot know (docs/experiments.md).
"""

import math
from dataclasses import dataclass, fields
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.config import DescriptorConfig
from panoloc.core.features.equalization import equalization_tables, equalize
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.features.patch_descriptors import (
    ViewDescriptors,
    centered_roots,
    described,
    pooled,
    principal_basis,
    spreads_of,
)
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.features.patch_histograms import soft_histograms


@dataclass(frozen=True)
class DescribedViews:
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

    @property
    def grid(self) -> PatchGrid:
        """Return the grid of the patches."""
        rows = math.isqrt(self.steps.shape[1] // 2)
        return PatchGrid(rows, 2 * rows)

    def descriptors(self, halvings: int = 0) -> ViewDescriptors:
        """Return the descriptors as numbers, of patches taken together in squares of 2 ^ `halvings` a side, up to 2; those are kept."""
        if halvings:
            return self._pooled[halvings - 1]
        return ViewDescriptors(self._values(), self.basis, self.weights.float(), self.spreads)

    def _values(self) -> Tensor:
        return self.steps.float().mul_(self.scale[:, None, None])

    @cached_property
    @torch.inference_mode(False)  # they outlive the query that asked for them first
    def _pooled(self) -> tuple[ViewDescriptors, ViewDescriptors]:
        halved = pooled(self._values(), self.weights.float())
        return self._with_spreads(*halved), self._with_spreads(*pooled(*halved))

    def _with_spreads(self, values: Tensor, weights: Tensor) -> ViewDescriptors:
        return ViewDescriptors(values, self.basis, weights, spreads_of(values, weights))

    @cached_property
    @torch.inference_mode(False)  # they outlive the query that asked for them first
    def spreads(self) -> Tensor:
        """Return how the descriptors of each view spread, (T, D, D); see `spreads_of`."""
        return spreads_of(self._values(), self.weights.float())

    @cached_property
    @torch.inference_mode(False)  # they outlive the query that asked for them first
    def tables(self) -> Tensor:
        """Return the tables (3, 256) that equalize all pictures together."""
        colors, seen = self.pictures.flatten(0, 2), self.seen.flatten()
        return equalization_tables(colors[None].float() / 255, seen[None].float())[0]

    def take(self, keep: Tensor) -> "DescribedViews":
        """Return the views numbered `keep`."""
        return DescribedViews(
            self.steps[keep], self.scale[keep], self.basis, self.weights[keep], self.pictures[keep], self.seen[keep]
        )

    def to(self, device: torch.device | str) -> "DescribedViews":
        """Return the views on `device`."""
        return DescribedViews(*(getattr(self, field.name).to(device) for field in fields(self)))

    @property
    def num_bytes(self) -> int:
        """Return the memory of all arrays, those included that the first query adds."""
        tensors = [getattr(self, field.name) for field in fields(self)]
        # A quarter and a sixteenth of the descriptors as floats, and their spreads.
        added = 4 * self.steps.numel() * 5 // 16 + 4 * len(self.steps) * self.steps.shape[2] ** 2
        return int(added + sum(tensor.numel() * tensor.element_size() for tensor in tensors))


@dataclass(frozen=True)
class RenderedViews:
    """Views of a batch: color (B, H, W, 3) in 0..1, canonical (B, H W, 3), valid (B, H, W) bool, weights (B, H, W) solid angles."""

    color: Tensor
    canonical: Tensor
    valid: Tensor
    weights: Tensor


class ViewCollector:
    """Describes views batch by batch. The basis comes from views that lie evenly among all, given first."""

    def __init__(self, config: DescriptorConfig, is_labels: bool, sample: RenderedViews) -> None:
        self._config, self._is_labels = config, is_labels
        self._grid = PatchGrid(config.patch_rows, 2 * config.patch_rows)
        self._solid_angles = self._grid.solid_angles(sample.color.device)
        roots, _ = centered_roots(described_histograms(sample, self._grid, config.bins, is_labels), self._solid_angles)
        self._basis = principal_basis(roots, config.size)
        self._parts: list[DescribedViews] = []

    def add(self, views: RenderedViews) -> None:
        """Describe a batch."""
        histograms = described_histograms(views, self._grid, self._config.bins, self._is_labels)
        values, weights = described(histograms, self._solid_angles, self._basis)
        scale = values.abs().amax((1, 2)).clamp_min(1e-9) / self._config.steps
        steps = (values / scale[:, None, None]).round().to(torch.int8)
        pictures, seen = small_pictures(views, self._config.picture_height)
        self._parts.append(DescribedViews(steps, scale, self._basis, weights.half(), pictures, seen))

    def collected(self, keep: Tensor) -> DescribedViews:
        """Return the views numbered `keep` of all that were added."""
        names = ("steps", "scale", "weights", "pictures", "seen")
        joined = {name: torch.cat([getattr(part, name) for part in self._parts]) for name in names}
        return DescribedViews(**joined, basis=self._basis).take(keep)


def described_histograms(views: RenderedViews, grid: PatchGrid, bins: int, is_labels: bool) -> Tensor:
    """Return what patches are described by: histograms of equalized colours and, next to them, of local contrast (B, P, 2 bins³).

    Labels have no light: (B, P, bins³).
    """
    batch, height, width, _ = views.color.shape
    patch = grid.patch_of_pixel(height, width, views.color.device).flatten().expand(batch, -1)
    weights, parts = views.weights.flatten(1), [views.canonical]
    if not is_labels:
        parts.append(equalize(local_contrast(views.color, views.valid.float()).flatten(1, 2), weights))
    return soft_histograms(parts, weights, patch, len(grid), bins)


def small_pictures(views: RenderedViews, height: int) -> tuple[Tensor, Tensor]:
    """Return pictures (B, h, 2h, 3) uint8 averaged over what was seen, and where at least half was (B, h, 2h)."""
    planes = torch.cat((views.color * views.valid[..., None], views.valid[..., None].float()), dim=-1).permute(
        0, 3, 1, 2
    )
    small = torch.nn.functional.interpolate(planes, size=(height, 2 * height), mode="area")
    color = small[:, :3] / small[:, 3:].clamp_min(1e-6)
    return (color.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).contiguous(), small[:, 3] >= 0.5
