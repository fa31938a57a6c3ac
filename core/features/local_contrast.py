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
from panoloc.core.geometry.sphere_window import SphereWindow, directions_of, solid_angles_of
from panoloc.core.kernels.library import call, has_kernels_for


def local_contrast(color: Tensor, valid: Tensor, window: SphereWindow | None = None) -> Tensor:
    """Return the ratio of (B, H, W, 3) colours to their surroundings, its logarithm squashed to 0..1; 0.5 where there is no contrast.

    color: float32 in 0..1; valid: (B, H, W) float32, 0 where a pixel is missing. window: the part of the sphere that they are of; None:
    all of it. Surroundings are round on the sphere, so that a turned camera sees the same contrast.
    """
    window = window or SphereWindow.of_sphere(color.shape[1])
    mean, known = _surroundings(color, valid, window), valid[..., None]
    if has_kernels_for(color):
        contrast = color.new_empty(color.shape)
        images = color, valid, *color.shape[:3]
        around = mean, *mean.shape[2:], int(window.is_round)
        call("local_contrast", *images, *around, CONTRAST.darkest, CONTRAST.scale, contrast)
        return contrast
    contrast = (color + CONTRAST.darkest).log_().mul_(known)
    contrast -= enlarged(mean, (window.height, window.width), window.is_round).permute(0, 2, 3, 1)
    return contrast.mul_(known / CONTRAST.scale).tanh_().add_(1).mul_(0.5)


def mean_around(sums: Tensor, weights: Tensor) -> Tensor:
    """Return the mean (..., 3, S) around each of S pixels, of sums over its cell of values and validity (..., 4, S).

    weights: (S, S), how much each pixel (first axis) counts around each other one.
    """
    total = sums @ weights
    return total[..., :3, :] / total[..., 3:, :].clamp_min(1e-6)


def weights_between(directions: Tensor, solid: Tensor) -> Tensor:
    """Return how much each of S directions (first axis), with its solid angle (S,), counts around each other one, (S, S)."""
    return solid[:, None] * (CONTRAST.concentration * (directions @ directions.T - 1)).exp()


def enlarged(mean: Tensor, size: tuple[int, int], is_round: bool) -> Tensor:
    """Return smooth images (B, C, h, w) at another size (H, W), bilinearly, around the seam where the last column is beside the first."""
    if not is_round:
        return torch.nn.functional.interpolate(mean, size=size, mode="bilinear")
    # Some columns more on each side, as many as are whole columns of the large image.
    margin = mean.shape[-1] // math.gcd(mean.shape[-1], size[1])
    wide_margin = margin * size[1] // mean.shape[-1]
    wrapped = torch.nn.functional.pad(mean, (margin, margin, 0, 0), mode="circular")
    wide = torch.nn.functional.interpolate(wrapped, size=(size[0], size[1] + 2 * wide_margin), mode="bilinear")
    return wide[..., wide_margin:-wide_margin]


def _surroundings(color: Tensor, valid: Tensor, window: SphereWindow) -> Tensor:
    """Return the weighted mean logarithm of (B, H, W, 3) colours around each pixel of a small image, (B, 3, h, w)."""
    stride, around = max(1, window.rows // (4 * CONTRAST.rows)), window.at(CONTRAST.rows)
    some = slice(stride // 2, None, stride)
    known = valid[:, some, some, None]
    logarithms = (color[:, some, some] + CONTRAST.darkest).log_().mul_(known)
    planes = torch.cat((logarithms, known), dim=-1).permute(0, 3, 1, 2)
    small = torch.nn.functional.interpolate(planes, size=(around.height, around.width), mode="area")
    mean = mean_around(small.flatten(2), _weights_around(around, color.device))
    return mean.view(len(color), 3, around.height, around.width)


@lru_cache(maxsize=8)
@torch.inference_mode(False)  # it outlives the query that asked for it first
def _weights_around(window: SphereWindow, device: torch.device) -> Tensor:
    return weights_between(directions_of(window, device), solid_angles_of(window, device))
