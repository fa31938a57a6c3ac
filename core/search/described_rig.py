"""What the images of a rig look like, as the search holds it against maps."""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.config import DescriptorConfig
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.equalization import equalize
from panoloc.core.features.patch_descriptors import DescribedPatches, centered_roots, pooled
from panoloc.core.features.patch_histograms import PatchGrid, soft_histograms

_LEAST_PATCH_SHARE = 0.25  # of the patch that shows most; patches that show less say little and cost as much


@dataclass(frozen=True)
class RigPixels:
    """The pixels of images at one resolution, in the axes of the rig, square by square.

    directions: (S, 3), unit vectors. centers: (S, 3) metres, of the camera that each is of. colors: (S, 3) in 0..1, equalized over all of
    them, once for all poses: that some see less of the scan where a photo looks hardly moves its colours; codes where is_labels. solid:
    (S,) solid angles. squares: (S,) int64, ascending, the square of pixels that each is in. rows: of a sphere at that resolution.
    """

    directions: Tensor
    centers: Tensor
    colors: Tensor
    solid: Tensor
    squares: Tensor
    rows: int
    is_labels: bool

    def __len__(self) -> int:
        return len(self.directions)

    @cached_property
    def members(self) -> Tensor:
        """Return which pixels are in which square, (S, G), 1 or 0."""
        return torch.nn.functional.one_hot(self.squares).float()


class DescribedRig:
    """What the images look like, the same for all maps that share their colours."""

    def __init__(self, colors: CanonicalColors, config: DescriptorConfig) -> None:
        self._pyramid, self._config = colors.pyramid, config
        # Of patches that are taken together so often.
        self._known: defaultdict[int, dict[int, tuple[Tensor, Tensor]]] = defaultdict(dict)
        self._grid = PatchGrid(config.patch_rows, 2 * config.patch_rows)
        windows = self._pyramid.windows(config.view_height)
        seen = windows.weights > 0
        weights = windows.weights[seen]
        patch = self._grid.patch_of_direction(windows.rig_directions[seen])
        parts = [colors.equalized(windows)]
        if not colors.is_labels:
            contrast = colors.contrast(windows)[:, seen].T[None]
            parts.append(torch.zeros_like(windows.color))
            parts[1][:, seen] = equalize(contrast, weights[None])[0].T
        shown = [part[:, seen].T[None] for part in parts]
        histograms = soft_histograms(shown, weights[None], patch[None], len(self._grid), config.bins)
        # A patch at the edge of an image counts as much as the image shows of it.
        self._shown = torch.zeros(len(self._grid), device=weights.device).index_add_(0, patch, weights)
        roots, _ = centered_roots(histograms, self._grid.solid_angles(weights.device))
        self._roots = roots[0]

    def patches(self, basis: Tensor, halvings: int = 0) -> DescribedPatches:
        """Return the patches along a basis (B, D), taken together in squares of 2 ^ `halvings` a side."""
        if not halvings:
            chosen = (self._shown > _LEAST_PATCH_SHARE * self._shown.max()).nonzero()[:, 0]
            weights = self._shown[chosen]
            values = self._roots[chosen] @ basis
            return DescribedPatches(values, chosen, weights / weights.sum(), self._grid, self._known[0])
        values, weights = (self._roots @ basis)[None], self._shown[None]
        for _ in range(halvings):
            values, weights = pooled(values, weights)
        chosen = weights[0].nonzero()[:, 0]
        kept = weights[0, chosen]
        grid, known = self._grid.halved(halvings), self._known[halvings]
        return DescribedPatches(values[0, chosen], chosen, kept / kept.sum(), grid, known)

    @property
    def share(self) -> float:
        """Return the share of the sphere, 0..1, that the images show."""
        return self._pyramid.share

    @cached_property
    def pixels(self) -> RigPixels:
        """Return the pixels at the resolution of the map's small pictures."""
        return self._pixels(self._config.picture_height)

    @cached_property
    def finer_pixels(self) -> RigPixels:
        """Return the pixels at twice that resolution."""
        return self._pixels(2 * self._config.picture_height)

    @property
    def large_pixels(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return directions (S, 3), colours (S, 3) as taken, and solid angles (S,) of pixels as large as patches."""
        windows = self._pyramid.windows(self._config.patch_rows)
        valid = windows.weights > 0
        return windows.rig_directions[valid], windows.color[:, valid].T, windows.weights[valid]

    def _pixels(self, rows: int) -> RigPixels:
        """Return the pixels at `rows` to a sphere, in squares of two patches a side."""
        side = round(rows * 2 * self._config.patch_deg / 180)
        windows = self._pyramid.windows(rows)
        valid = windows.weights > 0
        row, column = valid.nonzero(as_tuple=True)
        image = windows.image[valid]
        square = (image * windows.shape[0] + row // side) * windows.shape[1]
        squares, order = torch.unique(square + column // side, return_inverse=True)[1].sort(stable=True)
        row, column, image = row[order], column[order], image[order]
        directions, solid = windows.rig_directions[row, column], windows.weights[row, column]
        colors, is_labels = windows.color[:, row, column].T.contiguous(), self._pyramid.labels is not None
        if not is_labels:
            colors = equalize(colors[None], solid[None])[0]
        return RigPixels(directions, self._pyramid.centers[image], colors, solid, squares, rows, is_labels)
