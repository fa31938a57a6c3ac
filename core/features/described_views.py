"""What a map keeps of its synthetic views: descriptors of patches, and small pictures.

Patches of 11 degrees propose poses of a photo; taken together two by two, those of a panorama. A small picture of each view lets thousands
of poses be scored again by what is inside of patches, which histograms cannot know (docs/experiments.md).
"""

import math
from collections.abc import Iterator
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
    pooled,
    principal_basis,
    spreads_of,
)
from panoloc.core.features.patch_histograms import PatchGrid, soft_histograms

_AT_ONCE = 16  # views


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
        values, weights = (torch.cat(each) for each in zip(*self._parts(), strict=True))
        return ViewDescriptors(values, self.basis, weights, self.spreads)

    def _parts(self) -> Iterator[tuple[Tensor, Tensor]]:
        """Return descriptors (t, P, D) and weights (t, P) as numbers, of so few views at a time that they stay in the processor's cache."""
        for steps, scale, weights in zip(
            *(torch.split(each, _AT_ONCE) for each in (self.steps, self.scale, self.weights)), strict=True
        ):
            yield steps.float().mul_(scale[:, None, None]), weights.float()

    @cached_property
    @torch.inference_mode(False)  # they outlive the query that asked for them first
    def _pooled(self) -> tuple[ViewDescriptors, ViewDescriptors]:
        parts = [pooled(*part) for part in self._parts()]
        values, weights = (torch.cat(each) for each in zip(*parts, strict=True))
        return self._with_spreads(values, weights), self._with_spreads(*pooled(values, weights))

    def _with_spreads(self, values: Tensor, weights: Tensor) -> ViewDescriptors:
        return ViewDescriptors(values, self.basis, weights, spreads_of(values, weights))

    @cached_property
    @torch.inference_mode(False)  # they outlive the query that asked for them first
    def spreads(self) -> Tensor:
        """Return how the descriptors of each view spread, (T, D, D); see `spreads_of`."""
        return torch.cat([spreads_of(*part) for part in self._parts()])

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


class ViewCollector:
    """Describes views batch by batch. The basis comes from views that lie evenly among all, given first."""

    def __init__(self, config: DescriptorConfig, is_labels: bool, color: Tensor, weights: Tensor) -> None:
        self._config, self._is_labels = config, is_labels
        self._grid = PatchGrid(config.patch_rows, 2 * config.patch_rows)
        self._solid_angles = self._grid.solid_angles(color.device)
        histograms = described_histograms(color, weights, self._grid, config.bins, is_labels)
        self._basis = principal_basis(centered_roots(histograms, self._solid_angles)[0], config.size)
        self._parts: list[DescribedViews] = []

    def add(self, color: Tensor, weights: Tensor) -> None:
        """Describe a batch: color (B, H, W, 3) in 0..1 and weights (B, H, W), solid angles, zero where nothing was seen."""
        histograms = described_histograms(color, weights, self._grid, self._config.bins, self._is_labels)
        values, shares = centered_roots(histograms, self._solid_angles, self._basis)
        scale = values.abs().amax((1, 2)).clamp_min(1e-9) / self._config.steps
        steps = (values / scale[:, None, None]).round().to(torch.int8)
        pictures, seen = small_pictures(color, weights > 0, self._config.picture_height)
        self._parts.append(DescribedViews(steps, scale, self._basis, shares.half(), pictures, seen))

    def collected(self, keep: Tensor) -> DescribedViews:
        """Return the views numbered `keep` of all that were added."""
        names = ("steps", "scale", "weights", "pictures", "seen")
        joined = {name: torch.cat([getattr(part, name) for part in self._parts])[keep] for name in names}
        return DescribedViews(**joined, basis=self._basis)


def described_histograms(color: Tensor, weights: Tensor, grid: PatchGrid, bins: int, is_labels: bool) -> Tensor:
    """Return what patches of views are described by: histograms of equalized colours and, next to them, of local contrast (B, P, 2 bins³).

    color: (B, H, W, 3) in 0..1; weights: (B, H, W), solid angles, zero where nothing was seen. Labels have no light: (B, P, bins³).
    """
    batch, height, width, _ = color.shape
    patch = grid.patch_of_pixel(height, width, color.device).flatten().expand(batch, -1)
    parts, flat = [color.flatten(1, 2)], weights.flatten(1)
    if not is_labels:
        contrast = local_contrast(color, (weights > 0).float()).flatten(1, 2)
        parts = [equalize(part, flat) for part in (*parts, contrast)]
    return soft_histograms(parts, flat, patch, len(grid), bins)


def small_pictures(color: Tensor, valid: Tensor, height: int) -> tuple[Tensor, Tensor]:
    """Return pictures (B, h, 2h, 3) uint8 averaged over what was seen of views, and where at least half was (B, h, 2h)."""
    planes = torch.cat((color * valid[..., None], valid[..., None].float()), dim=-1).permute(0, 3, 1, 2)
    small = torch.nn.functional.interpolate(planes, size=(height, 2 * height), mode="area")
    mean = small[:, :3] / small[:, 3:].clamp_min(1e-6)
    return (mean.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).contiguous(), small[:, 3] >= 0.5
