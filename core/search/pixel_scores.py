"""Scores of poses by what is inside of patches: the small picture of a view, held against photos pixel by pixel."""

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.equalization import equalize
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.search.described_rig import RigPixels

_RESCORED_AT_ONCE = 2_000_000  # pixels


class ComparedColors:
    """The colours of photos, ready to be compared with what scans show in the same directions."""

    def __init__(self, photos: RigPixels, is_labels: bool) -> None:
        self.photos, self._solid, self._is_labels = photos, photos.solid, is_labels
        self._member = torch.nn.functional.one_hot(photos.squares).float()  # (S, G)
        # Once for all poses: that some see less of the scan where a photo looks hardly moves its colours.
        self._own = photos.colors if is_labels else equalize(photos.colors[None], photos.solid[None])[0]

    def scores(self, pictures: Tensor, seen: Tensor, at: Tensor) -> Tensor:
        """Return the score (K,) of poses: mean correlation inside squares of pixels, and less where the scan shows less.

        pictures: (N, 3) uint8 and seen: (N,) bool, pixels of all views; at: (K, S), those that poses show in the directions of the photos.
        """
        scan = pictures.index_select(0, at.flatten()).view(*at.shape, 3).float() / 255
        weights = seen.index_select(0, at.flatten()).view(at.shape) * self._solid
        if not self._is_labels:
            scan = equalize(scan, weights)
        own = self._own.expand_as(scan)
        inside, mass = _correlation_in_squares(scan, own, weights, self._member)
        share = weights.sum(1) / self._solid.sum()
        # By how much the other side explains a square; what has changed says nothing, and least of all against a pose.
        inside = 1 - (1 - inside.clamp(0, 1).square()).sqrt()
        return (inside * mass).sum(1) / mass.sum(1).clamp_min(1e-9) * share.sqrt()

    def compiled_scores(
        self,
        pictures: Tensor,
        seen: Tensor,
        poses: tuple[Tensor, Tensor],
        moved: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        """Return the scores (K,) of poses, starts (K,) and rotations (K, 3, 3), by the kernel.

        pictures: (T, P, 3), and seen: (T, P), of all starts. moved: depths (T, P) of the pictures,
        metres, and how far (K, 3) from the starts the poses are.
        """
        photos, (starts, rotations) = self.photos, poses
        depth, offsets = moved or (None, None)
        scores = rotations.new_empty(len(starts))
        total = float(self._solid.sum())
        sides = photos.directions, photos.centers, self._own, self._solid, photos.squares, len(photos), total
        given = pictures, seen, depth, photos.rows
        rules = CONTRAST.noise, int(self._is_labels)
        moves = len(starts), starts, rotations, offsets
        call("pixel_scores", *given, *sides, *rules, *moves, scores)
        return scores


def pixel_scores(
    photos: RigPixels,
    views: DescribedViews,
    rotations: Tensor,
    start: Tensor,
    rotation: Tensor,
    is_labels: bool,
) -> Tensor:
    """Return the score (K,) of poses, the starts numbered `start` (K,) with the rotations numbered `rotation` (K,)."""
    pictures, seen = views.pictures.flatten(0, 2), views.seen.flatten()
    height, size = views.pictures.shape[1], views.pictures.shape[1] * views.pictures.shape[2]
    compared, scores = ComparedColors(photos, is_labels), []
    if has_kernels_for(rotations):
        return compared.compiled_scores(views.pictures, views.seen, (start, rotations[rotation]))
    step = max(1, _RESCORED_AT_ONCE // len(photos))
    for s, r in zip(torch.split(start, step), torch.split(rotation, step), strict=True):
        towards = torch.einsum("kab,sb->ksa", rotations[r], photos.directions)
        scores.append(compared.scores(pictures, seen, s[:, None] * size + pixels_towards(towards, height)))
    return torch.cat(scores)


def _correlation_in_squares(first: Tensor, second: Tensor, weights: Tensor, member: Tensor) -> tuple[Tensor, Tensor]:
    """Return the correlation (K, G) of colours (K, S, 3) inside each square, all channels together, and what the squares weigh."""
    mass = weights @ member
    per = 1 / mass.clamp_min(1e-9)
    # One plane after the other, weighted in place: nothing is copied for the product then.
    planes = first.new_empty((9, *weights.shape))
    planes[:3], planes[3:6] = first.movedim(-1, 0), second.movedim(-1, 0)
    torch.stack(
        (_summed(planes[:3] * planes[3:6]), _summed(planes[:3].square()), _summed(planes[3:6].square())), out=planes[6:]
    )
    mean = ((planes.mul_(weights)).flatten(0, 1) @ member).view(9, *mass.shape) * per
    mean_first, mean_second = mean[:3], mean[3:6]
    covariance = mean[6] - (mean_first * mean_second).sum(0)
    variances = mean[7] - mean_first.square().sum(0), mean[8] - mean_second.square().sum(0)
    power = (variances[0].clamp_min(0) + CONTRAST.noise) * (variances[1].clamp_min(0) + CONTRAST.noise)
    return covariance / power.sqrt(), mass


def _summed(planes: Tensor) -> Tensor:
    """Return the sum of three planes."""
    return planes[0] + planes[1] + planes[2]
