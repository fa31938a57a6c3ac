"""The panorama at several resolutions, colours averaged over valid pixels only."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from panoloc.core.camera.panorama import Panorama
from panoloc.core.features.equalization import LabelCodes, apply_tables, equalize
from panoloc.core.geometry.projection import pixel_solid_angles


@dataclass(frozen=True)
class PanoramaLevel:
    """One resolution: color (3, H, W) float32 in 0..1 (label codes for semantic panoramas), valid (H, W) float32 0 or 1."""

    color: Tensor
    valid: Tensor

    @property
    def height(self) -> int:
        """Return H."""
        return self.color.shape[1]

    def weights(self) -> Tensor:
        """Return the solid angle of each pixel (H, W), zero where it is not valid."""
        return self.valid * pixel_solid_angles(self.height, 2 * self.height, self.color.device)

    def canonical(self, labels: LabelCodes | None) -> Tensor:
        """Return canonical colours (3, H, W): equalized over the whole level, or the label codes as they are."""
        if labels is not None:
            return self.color
        flat = self.color.flatten(1).T[None]
        return equalize(flat, self.weights().flatten()[None])[0].T.reshape(self.color.shape)

    def recolored(self, tables: Tensor) -> Tensor:
        """Return the colours (3, H, W) looked up in `tables` (3, 256)."""
        return apply_tables(self.color.flatten(1).T[None], tables[None])[0].T.reshape(self.color.shape)


class PanoramaPyramid:
    """Levels of a panorama by their height in rows, made on demand from the one above."""

    def __init__(
        self, panorama: Panorama, max_height: int, labels: LabelCodes | None, device: torch.device | str
    ) -> None:
        color = torch.from_numpy(np.require(panorama.color, requirements=["C", "W"])).to(device)
        valid = torch.from_numpy(np.require(panorama.valid, requirements=["C", "W"])).to(device)
        if labels is None:
            image = color.permute(2, 0, 1).contiguous().float().div_(255)
        else:
            codes, known = labels.recode(color)
            image, valid = codes.permute(2, 0, 1), valid & known
        top = _mean_level(image, valid.float(), min(max_height, panorama.color.shape[0]))
        self._levels = {top.height: top}

    def level(self, height: int) -> PanoramaLevel:
        """Return the level with `height` rows (fewer where the panorama has fewer; enlarged never)."""
        top = max(self._levels.values(), key=lambda level: level.height)
        height = min(height, top.height)
        if height not in self._levels or self._levels[height].height != height:
            self._levels[height] = _mean_level(top.color, top.valid, height)
        return self._levels[height]


def _mean_level(color: Tensor, valid: Tensor, height: int) -> PanoramaLevel:
    """Average valid pixels over the cells of `height` x 2 `height`; a cell is valid when at least half of it is."""
    if bool(valid.all()):
        color = _mean_cells(color, height)
        return PanoramaLevel(color, torch.ones(color.shape[1:], device=color.device))
    total, share = _mean_cells(color * valid, height), _mean_cells(valid[None], height)[0]
    return PanoramaLevel((total / share.clamp_min(1e-6)).clamp(0, 1), (share >= 0.5).float())


def _mean_cells(planes: Tensor, height: int) -> Tensor:
    """Average planes (C, H, W) over the cells of `height` x 2 `height`."""
    while planes.shape[1] >= 2 * height and planes.shape[1] % 2 == 0 and planes.shape[2] % 2 == 0:
        # Two by two as far as that goes, which is several times faster than cells of any size.
        rows = planes[:, ::2] + planes[:, 1::2]
        planes = (rows[..., ::2] + rows[..., 1::2]).mul_(0.25)
    if planes.shape[1] == height:
        return planes
    return torch.nn.functional.interpolate(planes[None], size=(height, 2 * height), mode="area")[0]
