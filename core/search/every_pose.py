"""Scores of every start with a rotation at once, by what is inside of patches: a first look at all poses of a search.

With one rotation all starts show a photo's pixels at the same places of their pictures. So what
`panoloc.core.search.pixel_scores` sums pose by pose are here products of small matrices, one for each square of pixels,
and a pose costs a tenth. The price: the colours of the starts are equalized by one table for all of the map, not by
what each pose sees.
"""

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.equalization import equalize
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.search.described_rig import RigPixels

_STARTS_AT_ONCE = 512
_NUMBERS_AT_ONCE = 1 << 26  # that lie on a GPU: rotations are taken together there


def scores_of_every_pose(photos: RigPixels, views: DescribedViews, rotations: Tensor, is_labels: bool) -> Tensor:
    """Return the scores (T, R) of all T views with rotations (R, 3, 3): mean contrast explained inside squares of pixels, and less
    where the scan shows less."""
    if has_kernels_for(rotations):
        return _compiled_scores(photos, views, rotations, is_labels)
    squares = _Squares(photos, is_labels)
    tables = None if is_labels else views.tables
    pixels = pixels_towards(squares.directions @ rotations.mT, photos.rows)  # (R, G N)
    at_once = max(1, _NUMBERS_AT_ONCE // (5 * pixels.shape[1] * min(len(views.pictures), _STARTS_AT_ONCE)))
    groups = torch.split(pixels, 1 if rotations.device.type == "cpu" else at_once)
    scores = []
    for pictures, seen in zip(
        *(torch.split(part, _STARTS_AT_ONCE) for part in (views.pictures, views.seen)), strict=True
    ):
        planes = _Planes(pictures, seen, tables)
        scores.append(torch.cat([squares.scores(planes, at) for at in groups]).T)
    return torch.cat(scores)


def _compiled_scores(photos: RigPixels, views: DescribedViews, rotations: Tensor, is_labels: bool) -> Tensor:
    """Return what `scores_of_every_pose` returns, by the kernel."""
    tables = (torch.arange(256) / 255).expand(3, -1) if is_labels else views.tables
    own = photos.colors if is_labels else equalize(photos.colors[None], photos.solid[None])[0]
    count, rows = views.pictures.shape[:2]
    scores = rotations.new_empty((count, len(rotations)))
    shown = views.pictures, views.seen, tables, rows, count
    total = float(photos.solid.sum())
    sides = photos.directions, own, photos.solid, photos.squares, len(photos), total, CONTRAST.noise
    call("scores_of_every_pose", *shown, *sides, rotations, len(rotations), scores)
    return scores


class _Planes:
    """What T starts show, pixel by pixel, with the starts last: colors (P, 3, T) and their squares, summed over channels, (P, T), both zero
    where nothing was seen; seen (P, T)."""

    def __init__(self, pictures: Tensor, seen: Tensor, tables: Tensor | None) -> None:
        levels = pictures.flatten(1, 2).permute(1, 2, 0)  # (P, 3, T)
        self.seen = seen.flatten(1).T.float().contiguous()
        if tables is None:
            colors = levels.float() / 255
        else:
            colors = torch.stack(
                [table[level.long()] for table, level in zip(tables, levels.unbind(1), strict=True)], 1
            )
        self.colors = colors * self.seen[:, None]
        self.squares = self.colors.square().sum(1)


class _Squares:
    """The pixels of photos, square by square; those of the smaller squares are filled up with pixels of no weight.

    directions: (G N, 3), of N pixels in each of G squares.
    """

    def __init__(self, photos: RigPixels, is_labels: bool) -> None:
        square, counts = photos.squares, torch.bincount(photos.squares)
        number = torch.arange(len(square), device=square.device)
        place = number - (counts.cumsum(0) - counts)[square]
        self._shape = (len(counts), int(counts.max()))
        pixels = square.new_zeros(self._shape)
        pixels[square, place] = number
        solid = photos.solid.new_zeros(self._shape)
        solid[square, place] = photos.solid
        own = photos.colors if is_labels else equalize(photos.colors[None], photos.solid[None])[0]
        own = own[pixels]
        self.directions = photos.directions[pixels.flatten()]
        self._solid = solid[:, None]  # (G, 1, N)
        self._by_own = (solid[..., None] * own).flatten(1)[:, None]  # (G, 1, 3 N)
        ones = torch.ones_like(solid)[..., None]
        self._moments = (solid[..., None] * torch.cat((ones, own, own.square().sum(-1, keepdim=True)), -1)).mT
        self._total = photos.solid.sum()

    def scores(self, planes: _Planes, at: Tensor) -> Tensor:
        """Return the scores (R, T) of all starts where they show the pixels of the squares at `at` (R, G N)."""
        shape = len(at), *self._shape
        colors = planes.colors.index_select(0, at.flatten()).view(*shape, -1)  # (R, G, N, 3 T)
        seen = planes.seen.index_select(0, at.flatten()).view(*shape, -1)  # (R, G, N, T)
        squares = planes.squares.index_select(0, at.flatten()).view(*shape, -1)
        # Mass, and first and second moments of the photos, where the scan shows something.
        own = self._moments @ seen  # (R, G, 5, T)
        mass = own[:, :, 0]
        per = 1 / mass.clamp_min(1e-9)
        mean = (self._solid @ colors).view(*shape[:2], 3, -1) * per[:, :, None]
        own_mean = own[:, :, 1:4] * per[:, :, None]
        common = (self._by_own @ colors.view(*shape[:2], 3 * shape[2], -1))[:, :, 0] * per - (mean * own_mean).sum(2)
        variance = (self._solid @ squares)[:, :, 0] * per - mean.square().sum(2)
        own_variance = own[:, :, 4] * per - own_mean.square().sum(2)
        power = (variance.clamp_min(0) + CONTRAST.noise) * (own_variance.clamp_min(0) + CONTRAST.noise)
        explained = 1 - (1 - (common.clamp_min(0).square() / power).clamp_max(1)).sqrt()
        total = mass.sum(1)
        scores: Tensor = (explained * mass).sum(1) / total.clamp_min(1e-9) * (total / self._total).sqrt()
        return scores
