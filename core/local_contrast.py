"""Local contrast: what remains of an image when every lamp is taken out, not only their mean.

Equalized colours undo any change of the light that is the same everywhere. Lamps at night light one wall and leave the next one dark; what
survives is how much brighter each spot is than its surroundings, per channel: paint, edges, furniture.

Not in the paper. On night photographs in rooms scanned by day the right start comes first in 1.00 of the queries instead of 0.30, with
equalized colours and local contrast side by side (docs/experiments.md).
"""

import torch
from torch import Tensor

_DARKEST = 0.03  # added before the logarithm: below it there is only noise
_REACH_SHARE = 6 / 64  # of the height, to each side: surroundings of about 36 degrees


def local_contrast(color: Tensor, valid: Tensor) -> Tensor:
    """Return the logarithm of (B, H, W, 3) colours over their surroundings' mean logarithm, scaled to 0..1 per image and channel.

    color: float32 in 0..1; valid: (B, H, W) float32, 0 where a pixel is missing.
    """
    logarithm = (color + _DARKEST).log() * valid[..., None]
    contrast = logarithm - _mean_around(logarithm, valid)
    known = valid[..., None] > 0
    low = torch.where(known, contrast, torch.inf).amin((1, 2), keepdim=True)
    high = torch.where(known, contrast, -torch.inf).amax((1, 2), keepdim=True)
    scaled = (contrast - low) / (high - low).clamp_min(1e-6)
    return torch.where(known, scaled, torch.zeros(())).clamp(0, 1)


def _mean_around(values: Tensor, valid: Tensor) -> Tensor:
    """Return the mean of valid values (B, H, W, 3), zero where invalid, over a square around each pixel; around the seam as well."""
    reach = max(1, round(_REACH_SHARE * values.shape[1]))
    planes = torch.cat((values, valid[..., None]), dim=-1).permute(0, 3, 1, 2)
    planes = torch.nn.functional.pad(planes, (reach, reach, 0, 0), mode="circular")
    planes = torch.nn.functional.pad(planes, (0, 0, reach, reach), mode="replicate")
    sums = torch.nn.functional.avg_pool2d(planes, 2 * reach + 1, stride=1).permute(0, 2, 3, 1)
    return sums[..., :3] / sums[..., 3:].clamp_min(1e-6)
