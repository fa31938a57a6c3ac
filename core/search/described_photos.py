"""What photos look like, as the search holds it against maps."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import DescriptorConfig, FineViewConfig, PhotoSearchConfig
from panoloc.core.features.equalization import equalize
from panoloc.core.features.patch_descriptors import centered_roots
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.features.patch_histograms import soft_histograms
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_colors import PhotoContrast, equalized_windows

_LEAST_PATCH_SHARE = 0.25  # of the patch that shows most; patches that show less say little and cost as much
_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class PhotoPixels:
    """The pixels of photos at one resolution, in the axes of the rig.

    directions: (S, 3), unit vectors. centers: (S, 3) metres, of the camera that each is of. colors: (S, 3) in 0..1. solid: (S,) solid
    angles. squares: (S,) int64, the square of pixels that each is in. rows: of a sphere at that resolution.
    """

    directions: Tensor
    centers: Tensor
    colors: Tensor
    solid: Tensor
    squares: Tensor
    rows: int

    def __len__(self) -> int:
        return len(self.directions)


@dataclass(frozen=True)
class DescribedPhotos:
    """What photos look like, in the axes of the rig.

    roots: (Q, B) centred root histograms of the patches numbered `patches` (Q,), weighted `weights` (Q,), summing to one. pixels: at the
    resolution of the map's small pictures; finer: at twice that, None where nothing is looked at so closely.
    """

    roots: Tensor
    patches: Tensor
    weights: Tensor
    pixels: PhotoPixels
    finer: PhotoPixels | None = None


def describe_photos(
    atlas: PhotoAtlas,
    local_contrast: PhotoContrast | None,
    config: PhotoSearchConfig,
    fine: FineViewConfig,
    described: DescriptorConfig,
) -> DescribedPhotos:
    """Describe photos, the same for all maps that share their colours. local_contrast: None of labels, which have none."""
    grid = PatchGrid(fine.patch_rows, fine.patch_columns)
    windows = atlas.windows(described.view_height)
    seen = windows.weights > 0
    directions, weights = atlas.rig_directions(windows)[seen], windows.weights[seen]
    patch = grid.patch_of_direction(directions)
    canonical = windows.color if local_contrast is None else equalized_windows(windows)
    parts = [soft_histograms(canonical[:, seen].T[None], weights[None], patch[None], len(grid), described.bins)]
    if local_contrast is not None:
        contrast = equalize(local_contrast.of_windows(windows)[:, seen].T[None], weights[None])
        parts.append(soft_histograms(contrast, weights[None], patch[None], len(grid), described.bins))
    roots, _ = centered_roots(torch.cat(parts, dim=-1), grid.solid_angles(weights.device))
    # A patch at the edge of a photo counts as much as the photo shows of it.
    shown = torch.zeros(len(grid), device=weights.device).index_add_(0, patch, weights)
    patches = _some_of((shown > _LEAST_PATCH_SHARE * shown.max()).nonzero()[:, 0], config.most_patches)
    return DescribedPhotos(
        roots[0, patches],
        patches,
        shown[patches] / shown[patches].sum(),
        photo_pixels(atlas, fine.picture_height, config.patch_pixels),
        photo_pixels(atlas, 2 * fine.picture_height, 2 * config.patch_pixels),
    )


def photo_pixels(atlas: PhotoAtlas, rows: int, side: int) -> PhotoPixels:
    """Return the pixels of photos at `rows` to a sphere, in squares of `side` pixels a side."""
    windows = atlas.windows(rows)
    valid = windows.weights > 0
    row, column = valid.nonzero(as_tuple=True)
    square = (windows.photo[valid] * windows.color.shape[1] + row // side) * windows.color.shape[2]
    _, squares = torch.unique(square + column // side, return_inverse=True)
    directions, colors = atlas.rig_directions(windows)[valid], windows.color[:, valid].T.contiguous()
    centers = atlas.centers[windows.photo[valid]]
    return PhotoPixels(directions, centers, colors, windows.weights[valid], squares, rows)


def _some_of(patches: Tensor, most: int) -> Tensor:
    """Return at most so many of the patches (Q,), spread evenly over them: what several photos show is told by some of it."""
    if len(patches) <= most:
        return patches
    order = (torch.arange(len(patches), device=patches.device, dtype=torch.float64) * _GOLDEN).frac().argsort()
    return patches[order[:most].sort().values]
