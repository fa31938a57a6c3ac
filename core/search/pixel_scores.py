"""Scores of poses by what is inside of patches: the small pictures of views, held against photos pixel by pixel.

`pixel_scores` looks at poses one by one. `scores_of_every_pose` is a first look at all poses of a search: with one rotation all starts show
a photo's pixels at the same places of their pictures. So what is summed pose by pose are there products of small matrices, one for each
square of pixels, and a pose costs a tenth. The price: the colours of the starts are equalized by one table for all of the map, not by what
each pose sees.
"""

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.equalization import equalize
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.search.described_rig import RigPixels

_RESCORED_AT_ONCE = 2_000_000  # pixels
_STARTS_AT_ONCE = 512
_NUMBERS_AT_ONCE = 1 << 26  # that lie on a GPU: rotations are taken together there


def pixel_scores(
    photos: RigPixels, views: DescribedViews, rotations: Tensor, start: Tensor, rotation: Tensor
) -> Tensor:
    """Return the score (K,) of poses, the starts numbered `start` (K,) with the rotations numbered `rotation` (K,)."""
    if has_kernels_for(rotations):
        return compiled_scores(photos, views.pictures, views.seen, start, rotations[rotation])
    pictures, seen = views.pictures.flatten(0, 2), views.seen.flatten()
    (height, width), scores = views.pictures.shape[1:3], []
    step = max(1, _RESCORED_AT_ONCE // len(photos))
    for s, r in zip(torch.split(start, step), torch.split(rotation, step), strict=True):
        towards = torch.einsum("kab,sb->ksa", rotations[r], photos.directions)
        at = s[:, None] * (height * width) + pixels_towards(towards, height)
        scores.append(scores_at(photos, pictures, seen, at))
    return torch.cat(scores)


def scores_at(photos: RigPixels, pictures: Tensor, seen: Tensor, at: Tensor) -> Tensor:
    """Return the score (K,) of poses: mean correlation inside squares of pixels, and less where the scan shows less.

    pictures: (N, 3) uint8 and seen: (N,) bool, pixels of all views; at: (K, S), those that poses show in the directions of the photos.
    """
    scan = pictures.index_select(0, at.flatten()).view(*at.shape, 3).float() / 255
    weights = seen.index_select(0, at.flatten()).view(at.shape) * photos.solid
    if not photos.is_labels:
        scan = equalize(scan, weights)
    inside, mass = _correlation_in_squares(scan, photos.colors.expand_as(scan), weights, photos.members)
    share = weights.sum(1) / photos.solid.sum()
    # By how much the other side explains a square; what has changed says nothing, and least of all against a pose.
    inside = 1 - (1 - inside.clamp(0, 1).square()).sqrt()
    return (inside * mass).sum(1) / mass.sum(1).clamp_min(1e-9) * share.sqrt()


def compiled_scores(
    photos: RigPixels,
    pictures: Tensor,
    seen: Tensor,
    starts: Tensor,
    rotations: Tensor,
    depth: Tensor | None = None,
    offsets: Tensor | None = None,
) -> Tensor:
    """Return the scores (K,) of poses, starts (K,) and rotations (K, 3, 3), by the kernel.

    pictures: (T, P, 3), and seen: (T, P), of all starts. depth: (T, P) metres, of the pictures, and offsets: (K, 3) metres, how far from
    the starts the poses are; None where they are there.
    """
    scores = rotations.new_empty(len(starts))
    total = float(photos.solid.sum())
    sides = photos.directions, photos.centers, photos.colors, photos.solid, photos.squares, len(photos), total
    given = pictures, seen, depth, photos.rows
    rules = CONTRAST.noise, int(photos.is_labels)
    call("pixel_scores", *given, *sides, *rules, len(starts), starts, rotations, offsets, scores)
    return scores


def _correlation_in_squares(first: Tensor, second: Tensor, weights: Tensor, members: Tensor) -> tuple[Tensor, Tensor]:
    """Return the correlation (K, G) of colours (K, S, 3) inside each square, all channels together, and what the squares weigh."""
    mass = weights @ members
    per = 1 / mass.clamp_min(1e-9)
    # One plane after the other, weighted in place: nothing is copied for the product then.
    planes = first.new_empty((9, *weights.shape))
    planes[:3], planes[3:6] = first.movedim(-1, 0), second.movedim(-1, 0)
    torch.stack(
        (_summed(planes[:3] * planes[3:6]), _summed(planes[:3].square()), _summed(planes[3:6].square())), out=planes[6:]
    )
    mean = ((planes.mul_(weights)).flatten(0, 1) @ members).view(9, *mass.shape) * per
    mean_first, mean_second = mean[:3], mean[3:6]
    covariance = mean[6] - (mean_first * mean_second).sum(0)
    variances = mean[7] - mean_first.square().sum(0), mean[8] - mean_second.square().sum(0)
    power = (variances[0].clamp_min(0) + CONTRAST.noise) * (variances[1].clamp_min(0) + CONTRAST.noise)
    return covariance / power.sqrt(), mass


def _summed(planes: Tensor) -> Tensor:
    """Return the sum of three planes."""
    return planes[0] + planes[1] + planes[2]


def scores_of_every_pose(photos: RigPixels, views: DescribedViews, rotations: Tensor) -> Tensor:
    """Return the scores (T, R) of all T views with rotations (R, 3, 3): mean contrast explained inside squares of pixels, and less
    where the scan shows less."""
    levels = torch.arange(256, device=rotations.device)
    tables = (levels / 255).expand(3, -1) if photos.is_labels else views.tables
    if has_kernels_for(rotations):
        count, rows = views.pictures.shape[:2]
        found = rotations.new_empty((count, len(rotations)))
        shown = views.pictures, views.seen, tables, rows, count
        sides = photos.directions, photos.colors, photos.solid, photos.squares, len(photos), float(photos.solid.sum())
        call("scores_of_every_pose", *shown, *sides, CONTRAST.noise, rotations, len(rotations), found)
        return found
    squares = _Squares(photos)
    pixels = pixels_towards(squares.directions @ rotations.mT, photos.rows)  # (R, G N)
    at_once = max(1, _NUMBERS_AT_ONCE // (5 * pixels.shape[1] * min(len(views.pictures), _STARTS_AT_ONCE)))
    groups = torch.split(pixels, 1 if rotations.device.type == "cpu" else at_once)
    scores = []
    for pictures, seen in zip(
        *(torch.split(part, _STARTS_AT_ONCE) for part in (views.pictures, views.seen)), strict=True
    ):
        planes = _planes(pictures, seen, tables)
        scores.append(torch.cat([squares.scores(*planes, at) for at in groups]).T)
    return torch.cat(scores)


def _planes(pictures: Tensor, seen: Tensor, tables: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return what T starts show, pixel by pixel, with the starts last: which pixels were seen (P, T), colors (P, 3, T), and their squares,
    summed over channels, (P, T), both zero where nothing was seen."""
    levels = pictures.flatten(1, 2).permute(1, 2, 0).unbind(1)
    shown = seen.flatten(1).T.float().contiguous()
    colors = torch.stack([table[level.long()] for table, level in zip(tables, levels, strict=True)], 1)
    colors = colors * shown[:, None]
    return shown, colors, colors.square().sum(1)


class _Squares:
    """The pixels of photos, square by square; those of the smaller squares are filled up with pixels of no weight.

    directions: (G N, 3), of N pixels in each of G squares.
    """

    def __init__(self, photos: RigPixels) -> None:
        square, counts = photos.squares, torch.bincount(photos.squares)
        number = torch.arange(len(square), device=square.device)
        place = number - (counts.cumsum(0) - counts)[square]
        self._shape = (len(counts), int(counts.max()))
        pixels = square.new_zeros(self._shape)
        pixels[square, place] = number
        solid = photos.solid.new_zeros(self._shape)
        solid[square, place] = photos.solid
        own = photos.colors[pixels]
        self.directions = photos.directions[pixels.flatten()]
        self._solid = solid[:, None]  # (G, 1, N)
        self._by_own = (solid[..., None] * own).flatten(1)[:, None]  # (G, 1, 3 N)
        ones = torch.ones_like(solid)[..., None]
        self._moments = (solid[..., None] * torch.cat((ones, own, own.square().sum(-1, keepdim=True)), -1)).mT
        self._total = photos.solid.sum()

    def scores(self, seen: Tensor, colors: Tensor, squares: Tensor, at: Tensor) -> Tensor:
        """Return the scores (R, T) of all starts, of planes as `_planes` has them, where they show the squares at `at` (R, G N)."""
        shape = len(at), *self._shape
        colors = colors.index_select(0, at.flatten()).view(*shape, -1)  # (R, G, N, 3 T)
        seen = seen.index_select(0, at.flatten()).view(*shape, -1)  # (R, G, N, T)
        squares = squares.index_select(0, at.flatten()).view(*shape, -1)
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
