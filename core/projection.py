"""The equirectangular projection Π and its inverse, and sampling of equirectangular images.

Convention (pinned by tests): camera frame x forward, y left, z up. Column coordinate `u` in [0, W), row coordinate `v` in
[0, H], pixel centres at half-integers: azimuth = π − 2π u / W, elevation = π/2 − π v / H. The left edge looks backwards.

Paper: §3.1.
Deviation: the reference implementation clips coordinates before sampling, which folds ten columns at each side of the seam;
here the seam wraps and rows beyond a pole continue on the opposite meridian.
"""

import math

import torch
from torch import Tensor


def project(points: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Project camera-frame points (..., 3) to pixel coordinates `u` in [0, W) and `v` in [0, H], each (...).

    The origin has no direction; it lands in the forward direction and its depth of zero tells it apart.
    """
    x, y, z = points.unbind(-1)
    azimuth = torch.atan2(y, x)
    elevation = torch.atan2(z, torch.hypot(x, y))
    u = (math.pi - azimuth) * (width / (2 * math.pi))
    v = (math.pi / 2 - elevation) * (height / math.pi)
    return torch.where(u >= width, u - width, u), v


def unproject(u: Tensor, v: Tensor, height: int, width: int) -> Tensor:
    """Return the unit viewing directions (..., 3) of pixel coordinates `u`, `v` (...): Π⁻¹."""
    azimuth = math.pi - u * (2 * math.pi / width)
    elevation = math.pi / 2 - v * (math.pi / height)
    cosine = torch.cos(elevation)
    return torch.stack((cosine * torch.cos(azimuth), cosine * torch.sin(azimuth), torch.sin(elevation)), dim=-1)


def pixel_directions(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """Return the unit viewing direction (H, W, 3) of every pixel centre."""
    v, u = torch.meshgrid(
        torch.arange(height, device=device, dtype=torch.float64) + 0.5,
        torch.arange(width, device=device, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    return unproject(u, v, height, width).float()


def pixel_solid_angles(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """Return the solid angle (H, 1) in steradians of a pixel in each row; all pixels together cover 4π."""
    edges = torch.linspace(0, math.pi, height + 1, device=device, dtype=torch.float64)
    return ((edges[:-1].cos() - edges[1:].cos()) * (2 * math.pi / width)).float()[:, None]


def wrap_border(image: Tensor) -> Tensor:
    """Pad (C, H, W) by one pixel on each side as the sphere continues: around the seam and over the poles."""
    rolled = torch.roll(image, image.shape[-1] // 2, dims=-1)
    tall = torch.cat((rolled[:, :1], image, rolled[:, -1:]), dim=1)
    return torch.cat((tall[..., -1:], tall, tall[..., :1]), dim=2)


def bilinear_corners(u: Tensor, v: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Return flat indices (..., 4) into a bordered image (H + 2, W + 2) and bilinear weights (..., 4)."""
    column, row = u + 0.5, v + 0.5  # centre of the first real pixel lies at 1.0 of the bordered image
    left = column.floor().clamp_(0, width)
    top = row.floor().clamp_(0, height)
    right_share, bottom_share = column - left, row - top
    corner = (top * (width + 2) + left).long()
    corners = torch.stack((corner, corner + 1, corner + width + 2, corner + width + 3), dim=-1)
    weights = torch.stack(
        (
            (1 - right_share) * (1 - bottom_share),
            right_share * (1 - bottom_share),
            (1 - right_share) * bottom_share,
            right_share * bottom_share,
        ),
        dim=-1,
    )
    return corners, weights


def sample_bilinear(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Sample (C, H, W) at pixel coordinates (...), returning (..., C): the operator Γ of the paper (§3.3).

    Differentiable in `image`, `u` and `v` (piecewise, as bilinear interpolation is).
    """
    height, width = image.shape[-2:]
    bordered = wrap_border(image).flatten(1).T
    corners, weights = bilinear_corners(u, v, height, width)
    return (bordered[corners] * weights[..., None]).sum(-2)
