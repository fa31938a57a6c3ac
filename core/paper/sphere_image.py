"""A rig's images on one sphere, as the paper's method takes them: a panorama at one resolution."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.image.label_codes import LabelCodes


@dataclass(frozen=True)
class SphereImage:
    """color: (3, H, 2H) float32 in 0..1, or label codes; valid: (H, 2H) float32 0 or 1."""

    color: Tensor
    valid: Tensor

    @classmethod
    def of_panorama(
        cls, panorama: Panorama, most_rows: int, labels: LabelCodes | None, device: torch.device
    ) -> "SphereImage":
        """Return a panorama with colours averaged over valid pixels, in `most_rows` rows at most; a pixel is valid when half of it is."""
        pixels = torch.from_numpy(np.require(panorama.color, requirements=["C", "W"])).to(device)
        inside = torch.from_numpy(np.require(panorama.valid, requirements=["C", "W"])).to(device)
        color = pixels.float() / 255
        if labels is not None:
            color, known = labels.recode(pixels)
            inside = inside & known
        planes = torch.cat((color * inside[..., None], inside[..., None]), dim=-1).permute(2, 0, 1)
        rows = min(most_rows, len(inside))
        small = torch.nn.functional.interpolate(planes[None], size=(rows, 2 * rows), mode="area")[0]
        return cls((small[:3] / small[3:].clamp_min(1e-6)).clamp(0, 1), (small[3] >= 0.5).float())

    @property
    def height(self) -> int:
        """Return H."""
        return self.color.shape[1]

    def weights(self) -> Tensor:
        """Return the solid angle of each pixel (H, 2H), zero where it is not valid."""
        return self.valid * pixel_solid_angles(self.height, 2 * self.height, self.color.device)
