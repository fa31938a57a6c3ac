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

from panoloc.core.config import CONTRAST
from panoloc.core.geometry.sphere_window import SphereWindow

_ROWS = CONTRAST.rows


def local_contrast(color: Tensor, valid: Tensor, window: SphereWindow | None = None) -> Tensor:
    """Return the ratio of (B, H, W, 3) colours to their surroundings, its logarithm squashed to 0..1; 0.5 where there is no contrast.

    color: float32 in 0..1; valid: (B, H, W) float32, 0 where a pixel is missing. window: the part of the sphere that they are of; None:
    all of it. Surroundings are round on the sphere, so that a turned camera sees the same contrast.
    """
    window = window or SphereWindow.of_sphere(color.shape[1])
    known = valid[..., None]
    contrast = (color + CONTRAST.darkest).log_().mul_(known)
    contrast -= _mean_around(contrast, valid, window)
    return contrast.mul_(known / CONTRAST.scale).tanh_().add_(1).mul_(0.5)


def mixed_with_contrast(equalized: Tensor, color: Tensor, valid: Tensor, share: float) -> Tensor:
    """Return equalized colours (B, H, W, 3) mixed with a `share` in 0..1 of the local contrast of the colours as they were."""
    return torch.lerp(equalized, local_contrast(color, valid), share)


def _mean_around(values: Tensor, valid: Tensor, window: SphereWindow) -> Tensor:
    """Return the weighted mean around each pixel of values (B, H, W, 3) that are zero where invalid."""
    stride, around = max(1, window.rows // CONTRAST.sampled_rows), window.at(_ROWS)
    some = slice(stride // 2, None, stride)
    planes = torch.cat((values[:, some, some], valid[:, some, some, None]), dim=-1).permute(0, 3, 1, 2)
    small = torch.nn.functional.interpolate(planes, size=(around.height, around.width), mode="area")
    sums = small.flatten(2) @ _weights_around(around, str(values.device))
    mean = (sums[:, :3] / sums[:, 3:].clamp_min(1e-6)).view(len(values), 3, around.height, around.width)
    size = window.height, window.width
    if not window.is_round:
        return torch.nn.functional.interpolate(mean, size=size, mode="bilinear").permute(0, 2, 3, 1)
    # Some columns more on each side, as many as are whole columns of the large image, so that interpolation goes on around the seam.
    margin = around.width // math.gcd(around.width, window.width)
    wide_margin = margin * window.width // around.width
    wrapped = torch.nn.functional.pad(mean, (margin, margin, 0, 0), mode="circular")
    wide = torch.nn.functional.interpolate(wrapped, size=(size[0], size[1] + 2 * wide_margin), mode="bilinear")
    return wide[..., wide_margin:-wide_margin].permute(0, 2, 3, 1)


@lru_cache(maxsize=8)
def _weights_around(window: SphereWindow, device: str) -> Tensor:
    """Return how much each pixel (first axis) of the small image counts around each other one, (S, S)."""
    with torch.inference_mode(False):  # it outlives the query that asked for it first
        directions, solid = window.directions(torch.device(device)), window.solid_angles(torch.device(device))
        return solid[:, None] * (CONTRAST.concentration * (directions @ directions.T - 1)).exp()
