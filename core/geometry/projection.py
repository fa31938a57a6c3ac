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

LEAST_SINE = 0.05  # of the angle to a pole or a vanishing point; nearer ones hardly tell where around it something is


def project(points: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Project camera-frame points (..., 3) to pixel coordinates `u` in [0, W) and `v` in [0, H], each (...).

    The origin has no direction; it lands in the forward direction and its depth of zero tells it apart.
    """
    # Contiguous planes: on strided views the arc tangents alone cost fifteen times as much.
    x, y, z = (part.contiguous() for part in points.unbind(-1))
    azimuth = torch.atan2(y, x)
    elevation = torch.atan2(z, torch.hypot(x, y))
    u = (math.pi - azimuth) * (width / (2 * math.pi))
    v = (math.pi / 2 - elevation) * (height / math.pi)
    return torch.where(u >= width, u - width, u), v


def unproject(u: Tensor, v: Tensor, height: int, width: int) -> Tensor:
    """Return the unit viewing directions (..., 3) of pixel coordinates `u`, `v` (...): Π⁻¹."""
    azimuth, elevation = math.pi - u * (2 * math.pi / width), math.pi / 2 - v * (math.pi / height)
    cosine, rise = torch.cos(elevation), torch.sin(elevation) + torch.zeros_like(azimuth)
    return torch.stack((cosine * torch.cos(azimuth), cosine * torch.sin(azimuth), rise), dim=-1)


def pixel_directions(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """Return the unit viewing direction (H, W, 3) of every pixel centre."""
    u, v = (torch.arange(size, device=device, dtype=torch.float64) + 0.5 for size in (width, height))
    return unproject(u, v[:, None], height, width).float()


def pixels_towards(directions: Tensor, height: int) -> Tensor:
    """Return the flat numbers (...) int64 of the pixels that show directions (..., 3), in whole spheres of `height` rows."""
    u, v = project(directions, height, 2 * height)
    return v.long().clamp(0, height - 1) * (2 * height) + u.long().clamp(0, 2 * height - 1)


def pixel_solid_angles(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """Return the solid angle (H, 1) in steradians of a pixel in each row; all pixels together cover 4π."""
    edges = torch.linspace(0, math.pi, height + 1, device=device, dtype=torch.float64)
    return ((edges[:-1].cos() - edges[1:].cos()) * (2 * math.pi / width)).float()[:, None]


def wrap_border(image: Tensor) -> Tensor:
    """Pad (C, H, W) by one pixel on each side as the sphere continues: around the seam and over the poles."""
    half = image.shape[2] // 2
    rows = torch.cat((image[:, :1].roll(half, -1), image, image[:, -1:].roll(half, -1)), dim=1)
    return torch.cat((rows[..., -1:], rows, rows[..., :1]), dim=2)


def sample_planes(planes: Tensor, column: Tensor, row: Tensor) -> Tensor:
    """Sample planes (C, H, W) bilinearly at places (K, N) counted in pixels from the centre of the first one: (K, C, N)."""
    height, width = planes.shape[-2:]
    # grid_sample wants -1..1 between the outermost centres.
    grid = torch.stack((column * (2 / (width - 1)) - 1, row * (2 / (height - 1)) - 1), dim=-1)
    images = planes.expand(len(column), -1, -1, -1)
    sampled = torch.nn.functional.grid_sample(images, grid[:, None], align_corners=True, padding_mode="border")
    return sampled[:, :, 0]


def sample_bilinear(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Sample (C, H, W) at pixel coordinates (...), returning (..., C): the operator Γ of the paper (§3.3).

    Differentiable in `image`, `u` and `v` (piecewise, as bilinear interpolation is).
    """
    # The centre of the first pixel lies at 1.0 of the bordered image.
    sampled = sample_planes(wrap_border(image), u.reshape(1, -1) + 0.5, v.reshape(1, -1) + 0.5)
    return sampled[0].T.reshape(*u.shape, len(image))
