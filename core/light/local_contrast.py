"""Local contrast: what remains of an image when every lamp is taken out, not only their mean.

Equalized colours undo any change of the light that is the same everywhere. Lamps at night light one wall and leave the next one dark; what
survives is how much brighter each spot is than its surroundings, per channel: paint, edges, furniture.

Not in the paper. It decides where light falls from elsewhere than at the scan, in the search (patches described by both) and in the
refinement (colours mixed of both); docs/experiments.md, "Night".
"""

import math
from functools import lru_cache

import torch
from torch import Tensor

from core.config import CONTRAST
from core.geometry.projection import pixel_directions, pixel_solid_angles

_ROWS = CONTRAST.rows


def local_contrast(color: Tensor, valid: Tensor) -> Tensor:
    """Return the ratio of (B, H, W, 3) colours to their surroundings, its logarithm squashed to 0..1; 0.5 where there is no contrast.

    color: float32 in 0..1; valid: (B, H, W) float32, 0 where a pixel is missing. Surroundings are round on the sphere, so that a
    turned camera sees the same contrast.
    """
    known = valid[..., None]
    contrast = (color + CONTRAST.darkest).log_().mul_(known)
    contrast -= _mean_around(contrast, valid)
    return contrast.mul_(known / CONTRAST.scale).tanh_().add_(1).mul_(0.5)


def mixed_with_contrast(equalized: Tensor, color: Tensor, valid: Tensor, share: float) -> Tensor:
    """Return equalized colours (B, H, W, 3) mixed with a `share` in 0..1 of the local contrast of the colours as they were."""
    return torch.lerp(equalized, local_contrast(color, valid), share)


def _mean_around(values: Tensor, valid: Tensor) -> Tensor:
    """Return the weighted mean around each pixel of values (B, H, W, 3) that are zero where invalid."""
    batch, height, width, _ = values.shape
    stride = max(1, height // CONTRAST.sampled_rows)
    some = slice(stride // 2, None, stride)
    planes = torch.cat((values[:, some, some], valid[:, some, some, None]), dim=-1).permute(0, 3, 1, 2)
    small = torch.nn.functional.interpolate(planes, size=(_ROWS, 2 * _ROWS), mode="area")
    sums = small.flatten(2) @ _weights_around(str(values.device))
    mean = (sums[:, :3] / sums[:, 3:].clamp_min(1e-6)).view(batch, 3, _ROWS, 2 * _ROWS)
    # Some columns more on each side, as many as are whole columns of the large image, so that interpolation goes on around the seam.
    margin = 2 * _ROWS // math.gcd(2 * _ROWS, width)
    wide_margin = margin * width // (2 * _ROWS)
    wrapped = torch.nn.functional.pad(mean, (margin, margin, 0, 0), mode="circular")
    wide = torch.nn.functional.interpolate(wrapped, size=(height, width + 2 * wide_margin), mode="bilinear")
    return wide[..., wide_margin:-wide_margin].permute(0, 2, 3, 1)


@lru_cache(maxsize=4)
def _weights_around(device: str) -> Tensor:
    """Return how much each pixel (first axis) of the small image counts around each other one, (S, S)."""
    with torch.inference_mode(False):  # it outlives the query that asked for it first
        directions = pixel_directions(_ROWS, 2 * _ROWS, device).view(-1, 3)
        solid = pixel_solid_angles(_ROWS, 2 * _ROWS, device).expand(-1, 2 * _ROWS).reshape(-1, 1)
        return solid * (CONTRAST.concentration * (directions @ directions.T - 1)).exp()
