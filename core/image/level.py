"""One resolution of a rig's images, to be sampled together with its derivatives where points project to.

Each image has a centre of its own: the parallax between frames that a hand has moved, arm's length and more, is part of the projection.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.geometry.projection import LEAST_SINE, sample_planes

VALID_SHARE = 0.99  # of the four pixels that a sample mixes
BORDER = 2  # pixels around each window, of which the outer ones are there for derivatives alone


@dataclass(frozen=True)
class SampledPoints:
    """What images show where the N points of K candidates project to.

    planes: (K, 9, N): colour, its derivatives by azimuth and by elevation, per radian. directions: (K, U, 2, N), derivatives of the points'
    azimuth and elevation by a turn (rad) and a move (m) of the rig in its own frame, and by the logarithm of the focal length where
    that is unknown too: U is 6 or 7.
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


@dataclass(frozen=True)
class Level:
    """Windows of M images at `rows` to a sphere, packed below each other with a border of `BORDER` pixels.

    colors: (4, H, W) float32, colour and validity. places: (5, M), where each window lies: first column and row on its sphere, less the
    inner border; last column and row within the window, inner border included; its top in the planes. rotations: (M, 3, 3)
    rig_from_camera; centers: (M, 3) metres.
    """

    colors: Tensor
    rows: int
    places: Tensor
    rotations: Tensor
    centers: Tensor

    @cached_property
    def planes(self) -> Tensor:
        """Return planes (10, H, W): colour (3), its derivatives by azimuth (3) and by elevation (3) per radian, validity (1).

        At the edge of what is valid the derivative is unknown, not that towards a black pixel.
        """
        planes = self.colors.new_zeros((10, *self.colors.shape[1:]))
        planes[:3], planes[9] = self.colors[:3], self.colors[3]
        color, seen, per_rad = planes[:3], planes[9], self.rows / (2 * math.pi)
        # Columns run against the azimuth, rows against the elevation.
        across, down = seen[:, 2:] * seen[:, :-2] * per_rad, seen[2:] * seen[:-2] * per_rad
        torch.mul(color[:, :, :-2] - color[:, :, 2:], across, out=planes[3:6, :, 1:-1])
        torch.mul(color[:, :-2] - color[:, 2:], down, out=planes[6:9, 1:-1])
        return planes

    @cached_property
    def pixels(self) -> Tensor:
        """Return colour and validity (H, W, 4), pixel after pixel."""
        return self.colors.permute(1, 2, 0).contiguous()

    def sample(self, azimuth: Tensor, elevation: Tensor, image: Tensor | int, planes: Tensor | None = None) -> Tensor:
        """Return packed planes (K, C, N), colour and validity where none are given, at directions (K, N), radians.

        image: whose axes the directions are in, a number for each (K, N), or one for all.

        Outside of an image's window validity is zero.
        """
        planes = self.colors if planes is None else planes
        if isinstance(image, int):
            first_column, first_row, last_column, last_row, top = self.places[:, image]
        else:
            first_column, first_row, last_column, last_row, top = self.places.index_select(1, image.flatten()).view(
                5, *image.shape
            )
        per_rad = self.rows / math.pi
        # In pixels from the centre of a window's top-left pixel of the outer border.
        outer = BORDER - 1
        column = torch.minimum(((math.pi - azimuth) * per_rad - first_column).clamp_min_(0), last_column) + outer
        row = torch.minimum(((math.pi / 2 - elevation) * per_rad - first_row).clamp_min_(0), last_row) + top + outer
        return sample_planes(planes, column, row)

    def sample_points(
        self,
        points: Tensor,
        images: Tensor | None,
        rotations: Tensor,
        positions: Tensor,
        log_focals: Tensor | None = None,
    ) -> tuple[SampledPoints, Tensor]:
        """Sample where points (K, 3, N), each shown by the image in `images` (K, N), project to from K poses of the rig.

        images: None of a rig of one. Also tell which (K, N) fall on valid pixels. log_focals: (K,), logarithms of the factors by
        which the focal length of all images is longer than that of the level; it is a seventh unknown then.
        Paper: §3.3, the projection of Eq. 5 and its derivative.
        """
        inverse = rotations.transpose(1, 2)
        in_rig = torch.baddbmm(-(inverse @ positions[..., None]), inverse, points)
        cameras = None if images is None else self._cameras(images)
        in_camera = self._to_camera(in_rig, cameras)
        spread = None
        if log_focals is not None:
            # A longer focal length spreads what is beside the optical axis.
            factors = log_focals.exp()
            spread = torch.stack((torch.ones_like(factors), factors, factors), 1)
            in_camera = in_camera * spread[..., None]
        x, y, z = in_camera.unbind(1)
        flat_square = torch.addcmul(x.square(), y, y)
        flat = flat_square.sqrt()
        sampled = self.sample(torch.atan2(y, x), torch.atan2(z, flat), 0 if images is None else images, self.planes)
        # ∂azimuth/∂p = (-y, x, 0) / f² and ∂elevation/∂p = (-x z / f, -y z / f, f) / d², with f² = x² + y² and d² = x² + y² + z².
        square = torch.addcmul(flat_square, z, z).clamp_min_(1e-12)
        stable = torch.maximum(flat_square, square * LEAST_SINE**2)
        over = z / (flat.clamp_min(1e-6) * square)
        by_point = torch.stack(
            (-y / stable, x / stable, torch.zeros_like(x), -x * over, -y * over, flat / square), dim=1
        )
        by_point = by_point.view(len(points), 2, 3, -1)
        by_focal = []
        if spread is not None:
            by_focal = [by_point[:, :, 1] * y[:, None] + by_point[:, :, 2] * z[:, None]]
            by_point = by_point * spread[:, None, :, None]
        by_point = self._to_rig(by_point, cameras)  # (K, 2, 3, N)
        # A turn ω and a move τ of the rig take a point q of it to q - ω x q - τ.
        # The cross product by_point x in_rig, plane by plane: the library's own takes several times as long along this axis.
        (a, b, c), (x, y, z) = by_point.unbind(2), in_rig[:, None].unbind(2)
        by_turn = (b * z - c * y, c * x - a * z, a * y - b * x)
        directions = torch.stack((*by_turn, -a, -b, -c, *by_focal), dim=1)
        return SampledPoints(sampled[:, :9], directions), sampled[:, 9] > VALID_SHARE

    def _cameras(self, images: Tensor) -> Tensor:
        """Return planes (12, K, N) of the cameras that points are seen by: rotations, row by row, and centres.

        Planes, because products of a small matrix for each point take several times as long.
        """
        table = torch.cat((self.rotations.flatten(1), self.centers), dim=1).T.contiguous()
        return table.index_select(1, images.flatten()).view(12, *images.shape)

    def _to_camera(self, in_rig: Tensor, cameras: Tensor | None) -> Tensor:
        """Return points of the rig (K, 3, N) in the axes of their cameras."""
        if cameras is None:
            return self.rotations[0].T @ (in_rig - self.centers[0, :, None])
        moved = in_rig - cameras[9:].transpose(0, 1)
        rows = cameras[:9].view(3, 3, *cameras.shape[1:])
        return torch.stack([_sum_of_products(rows[:, axis], moved.unbind(1)) for axis in range(3)], dim=1)

    def _to_rig(self, vectors: Tensor, cameras: Tensor | None) -> Tensor:
        """Return directions (K, 2, 3, N) in the axes of cameras in those of the rig."""
        if cameras is None:
            return self.rotations[0] @ vectors
        rows = cameras[:9].view(3, 3, *cameras.shape[1:])[:, :, :, None]
        return torch.stack([_sum_of_products(row, vectors.unbind(2)) for row in rows], dim=2)


def _sum_of_products(first: Tensor, second: tuple[Tensor, ...]) -> Tensor:
    """Return the sum of the products of three planes each."""
    return (first[0] * second[0]).addcmul_(first[1], second[1]).addcmul_(first[2], second[2])
