"""What a panorama shows where points project to, and how that changes when the camera moves."""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.image.image_level import ImageLevel

MIN_COSINE = 0.05  # rows next to a pole: the azimuth derivative grows without bound there
MIN_DISTANCE_M = 0.05
VALID_SHARE = 0.99  # of the four pixels that a sample mixes


@dataclass(frozen=True)
class SampledPoints:
    """What the panorama shows where the N points of K candidates project to.

    planes: (K, 9, N): colour, its derivatives by azimuth and by elevation, as in `ImageLevel`. directions: (K, 6, 2, N), derivatives
    of the points' azimuth and elevation by a turn (rad) and a move (m) of the camera in its own frame, and by further unknowns.
    """

    planes: Tensor
    directions: Tensor

    @property
    def color(self) -> Tensor:
        """Return the colours (K, 3, N)."""
        return self.planes[:, :3]

    @property
    def derivatives(self) -> Tensor:
        """Return their derivatives by azimuth and by elevation (K, 3, 2, N) per radian."""
        return self.planes[:, 3:].view(len(self.planes), 2, 3, -1).transpose(1, 2)

    def apply_gain_offset(self, gain: Tensor, offset: Tensor) -> None:
        """Change all planes, in place, to another light: gain and offset (K, 3)."""
        self.planes.view(len(gain), 3, 3, -1).mul_(gain[:, None, :, None])
        self.color.add_(offset[..., None])


def sample_points(
    level: ImageLevel, place: Tensor, rotations: Tensor, positions: Tensor
) -> tuple[SampledPoints, Tensor]:
    """Sample the level where points (K, 3, N) project to from K poses; also tell which (K, N) fall on valid pixels."""
    inverse = rotations.transpose(1, 2)
    x, y, z = torch.baddbmm(-(inverse @ positions[..., None]), inverse, place).unbind(1)
    flat_square = torch.addcmul(x.square(), y, y)
    sampled = level.sample(torch.atan2(y, x), torch.atan2(z, flat_square.sqrt()))
    # A turn ω and a move τ take a point p to p - ω x p - τ, with f² = x² + y² and d² = x² + y² + z²:
    # ∂azimuth/∂p = (-y, x, 0) / f² and ∂elevation/∂p = (-x z / f, -y z / f, f) / d².
    square = torch.addcmul(flat_square, z, z).clamp_min_(MIN_DISTANCE_M**2)
    per_flat = flat_square.clamp_min(1e-12).rsqrt_()
    per_square = per_flat * torch.maximum(flat_square, square * MIN_COSINE**2).rsqrt_()
    over_x, over_y, none = x * per_square, y * per_square, torch.zeros_like(x)
    unit_x, unit_y, rise = x * per_flat, y * per_flat, z / square
    fall = -(flat_square * per_flat) / square
    by_turn = (z * over_x, -unit_y, z * over_y, unit_x, -flat_square * per_square, none)
    by_move = (over_y, rise * unit_x, -over_x, rise * unit_y, none, fall)
    directions = torch.stack((*by_turn, *by_move), dim=1)
    seen = SampledPoints(sampled[:, :9], directions.view(len(place), 6, 2, -1))
    return seen, sampled[:, 9] > VALID_SHARE
