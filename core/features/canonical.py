"""Canonical colours of a rig's images: equalized over all that they show, and mixed with their local contrast."""

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST
from panoloc.core.features.equalization import apply_tables, equalization_tables
from panoloc.core.features.local_contrast import enlarged, mean_around, weights_between
from panoloc.core.image.level import BORDER, Level
from panoloc.core.image.rig_pyramid import RigPyramid, Windows
from panoloc.core.kernels.library import call, has_kernels_for


class CanonicalColors:
    """The colours of a pyramid, made once for all maps that share them. Label codes are canonical as they are."""

    def __init__(self, pyramid: RigPyramid) -> None:
        self.pyramid = pyramid
        self._levels: dict[tuple[int, float, bool], Level] = {}
        self._means: list[Tensor] | None = None

    @property
    def is_labels(self) -> bool:
        """Return whether the colours are codes of labels."""
        return self.pyramid.labels is not None

    def level(self, rows: int, contrast_share: float, blur: bool = False) -> Level:
        """Return a level equalized over all images and mixed with contrast; blurred for the widest basin."""
        key = (rows, contrast_share, blur)
        if key not in self._levels:
            windows = self.pyramid.windows(min(rows, self.pyramid.finest_rows))
            self._levels[key] = self._level(windows, self._tables(windows), contrast_share, blur)
        return self._levels[key]

    def level_with(self, tables: Tensor | None, rows: int, contrast_share: float) -> Level:
        """Return a level equalized by the tables (3, 256) of one comparison and mixed with contrast; tables: None of labels."""
        return self._level(self.pyramid.windows(min(rows, self.pyramid.finest_rows)), tables, contrast_share)

    def equalized(self, windows: Windows) -> Tensor:
        """Return packed colours (3, H, W) equalized over all valid pixels of all images."""
        return _looked_up(windows.color, self._tables(windows))

    def _tables(self, windows: Windows) -> Tensor | None:
        """Return the tables (3, 256) that equalize the colours of all valid pixels of all images; None of labels."""
        if self.is_labels:
            return None
        return equalization_tables(windows.color.flatten(1).T[None], windows.weights.flatten()[None])[0]

    def contrast(self, windows: Windows) -> Tensor:
        """Return the packed local contrast (3, H, W) in 0..1, as `panoloc.core.features.local_contrast` has it for a sphere."""
        means = self._surroundings()
        around = [
            enlarged(mean[None], (window.valid.shape[0], window.valid.shape[1]), window.place.is_round)[0]
            for mean, window in zip(means, windows.each, strict=True)
        ]
        logarithms = (windows.color + CONTRAST.darkest).log_()
        ratio = logarithms.sub_(windows.packed(around)).mul_(windows.valid / CONTRAST.scale)
        return ratio.tanh_().add_(1).mul_(0.5)

    def _level(self, windows: Windows, tables: Tensor | None, contrast_share: float, blur: bool = False) -> Level:
        if tables is not None and has_kernels_for(windows.color):
            colors = self._mixed(windows, tables, contrast_share)
            return windows.level(_blurred(colors[:3], windows)) if blur else windows.level_of(colors)
        color = _looked_up(windows.color, tables)
        if tables is not None:
            color = torch.lerp(color, self.contrast(windows), contrast_share)
        return windows.level(_blurred(color, windows) if blur else color)

    def _mixed(self, windows: Windows, tables: Tensor, contrast_share: float) -> Tensor:
        """Return colours and validity (4, H, W) of a level by the kernel; in memory a pixel's numbers follow each other."""
        # What lies between windows is zero; around a whole sphere nothing is left.
        is_whole = len(windows.each) == 1 and windows.places[0].is_whole
        pixels = (torch.empty if is_whole else torch.zeros)((*windows.shape, 4))
        planes = windows.color, windows.valid, *windows.shape
        rules = tables, CONTRAST.darkest, CONTRAST.scale, float(contrast_share)
        for mean, place, top in zip(self._surroundings(), windows.places, windows.tops, strict=False):
            first = (top + BORDER) * windows.shape[1] + BORDER
            around = mean, *mean.shape[1:], int(place.is_round)
            call("mixed_colors", *planes, first, place.height, place.width, *around, *rules, pixels)
        return pixels.permute(2, 0, 1)

    def _surroundings(self) -> list[Tensor]:
        """Return the mean logarithm of colours around each pixel of small windows (3, h, w), over all images as one sphere."""
        if self._means is None:
            fine, small = self.pyramid.windows(4 * CONTRAST.rows), self.pyramid.windows(CONTRAST.rows)
            logarithms = (fine.color + CONTRAST.darkest).log_() * fine.valid
            planes = fine.inside(torch.cat((logarithms, fine.valid[None])))
            sizes = [window.valid.shape for window in small.each]
            cells = [
                torch.nn.functional.interpolate(plane[None], size=size, mode="area")[0].flatten(1)
                for plane, size in zip(planes, sizes, strict=True)
            ]
            towards = [part.flatten(1).T for part in small.inside(small.rig_directions.movedim(-1, 0))]
            solid = [part.flatten() for part in small.inside(small.solid_angles)]
            mean = mean_around(torch.cat(cells, 1), weights_between(torch.cat(towards), torch.cat(solid)))
            parts = torch.split(mean, [height * width for height, width in sizes], dim=1)
            self._means = [part.view(3, *size) for part, size in zip(parts, sizes, strict=True)]
        return self._means


def _looked_up(color: Tensor, tables: Tensor | None) -> Tensor:
    """Return packed colours (3, H, W) looked up in tables (3, 256), as they are without."""
    if tables is None:
        return color
    return apply_tables(color.flatten(1).T[None], tables[None])[0].T.reshape(color.shape)


def _blurred(color: Tensor, windows: Windows) -> Tensor:
    """Return packed colours (3, H, W) smoothed over valid pixels with the kernel 1 2 1 along both axes."""
    stacked = torch.cat((color * windows.valid, windows.valid[None]))
    windows.continue_around(stacked)
    rows = stacked.clone().mul_(2)
    rows[:, 1:] += stacked[:, :-1]
    rows[:, :-1] += stacked[:, 1:]
    total = rows.clone().mul_(2)
    total[..., 1:] += rows[..., :-1]
    total[..., :-1] += rows[..., 1:]
    return total[:3] / total[3:].clamp_min(1.0)
