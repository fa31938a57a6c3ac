"""Canonical colours of photos: equalized over all that the photos of a session show, and their local contrast."""

import math
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST
from panoloc.core.features.equalization import equalize
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_level import PhotoLevel, PhotoWindows

_SURROUNDINGS_ROWS = 32  # of the windows whose pixels stand for what is around


def equalized_windows(windows: PhotoWindows) -> Tensor:
    """Return the colours (3, H, W) of windows equalized over all valid pixels of all photos."""
    flat = windows.color.flatten(1).T[None]
    return equalize(flat, windows.weights.flatten()[None])[0].T.reshape(windows.color.shape)


class PhotoContrast:
    """The local contrast of the photos of an atlas, as `panoloc.core.features.local_contrast` has it for a sphere."""

    def __init__(self, atlas: PhotoAtlas) -> None:
        self._atlas = atlas

    def of_windows(self, windows: PhotoWindows) -> Tensor:
        """Return the contrast (3, H, W) of windows, in 0..1."""
        x, y, z = windows.direction.flatten(1)
        azimuth = torch.atan2(y, x)
        # Columns beyond the left edge of a full turn lie at azimuths just above -π.
        elevation = torch.atan2(z, torch.hypot(x, y))
        photo = 0 if len(self._atlas) == 1 else windows.photo.flatten()[None]
        around = self._surroundings.sample(azimuth[None], elevation[None], photo)[0, :3]
        ratio = (windows.color + CONTRAST.darkest).log() - around.view(windows.color.shape)
        return (ratio * (windows.valid / CONTRAST.scale)).tanh().add(1).mul(0.5)

    def mixed(self, windows: PhotoWindows, equalized: Tensor, share: float) -> Tensor:
        """Return equalized colours (3, H, W) mixed with a `share` in 0..1 of the contrast."""
        return torch.lerp(equalized, self.of_windows(windows), share)

    @cached_property
    def _surroundings(self) -> PhotoLevel:
        """Return the mean logarithm of colours around each pixel, the same for windows of any resolution."""
        small = self._atlas.windows(_SURROUNDINGS_ROWS)
        mean = _mean_around(self._atlas, small)
        planes = torch.cat((mean, torch.ones_like(mean[:1])))
        return PhotoLevel(
            planes, small.rows, small.tops, small.first_rows, small.first_columns, small.heights, small.widths
        )


def blurred_windows(color: Tensor, windows: PhotoWindows) -> Tensor:
    """Return colours (3, H, W) smoothed over valid pixels with the kernel 1 2 1 along both axes."""
    stacked = torch.cat((color * windows.valid, windows.valid[None]))
    rows = stacked.clone().mul_(2)
    rows[:, 1:] += stacked[:, :-1]
    rows[:, :-1] += stacked[:, 1:]
    total = rows.clone().mul_(2)
    total[..., 1:] += rows[..., :-1]
    total[..., :-1] += rows[..., 1:]
    return total[:3] / total[3:].clamp_min(1.0)


def _mean_around(atlas: PhotoAtlas, windows: PhotoWindows) -> Tensor:
    """Return the mean logarithm of colours (3, H, W) around each pixel, borders included, over the photos as one sphere."""
    directions = atlas.rig_directions(windows).flatten(0, 1)
    weights = windows.weights.flatten()
    some = weights > 0
    logarithms = (windows.color.flatten(1)[:, some] + CONTRAST.darkest).log()
    sums = torch.cat((logarithms, torch.ones_like(logarithms[:1]))) * weights[some]
    near = (CONTRAST.concentration * (directions[some] @ directions.T - 1)).exp()
    total = sums @ near
    # Where nothing is near, at the unused right of narrow windows, the mean of all is as good as any.
    mean = total[:3] / total[3:].clamp_min(1e-12)
    return torch.where(total[3:] > math.exp(-20), mean, logarithms.mean(1, keepdim=True)).view(windows.color.shape)
