"""One resolution of the photos of a rig, to be sampled where points project to.

Each photo has a centre of its own: the parallax between frames that a hand has moved, arm's length and more, is part of the projection.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.image.photo_level import PhotoLevel
from panoloc.core.refine.point_sampling import MIN_COSINE, MIN_DISTANCE_M, VALID_SHARE, SampledPoints


@dataclass(frozen=True)
class RigLevel:
    """A level of M photos with their poses: rotations (M, 3, 3) rig_from_camera, centers (M, 3) metres."""

    level: PhotoLevel
    rotations: Tensor
    centers: Tensor

    def sample_points(
        self,
        place: Tensor,
        photos: Tensor | None,
        rotations: Tensor,
        positions: Tensor,
        log_focal: Tensor | None = None,
    ) -> tuple[SampledPoints, Tensor]:
        """Sample where points (K, 3, N), each shown by the photo in `photos` (K, N), project to from K poses of the rig.

        Also tell which (K, N) fall on valid pixels. log_focal: (), the logarithm of the factor by which the focal length of all photos is
        longer than that of the level; it is a seventh unknown then, by which directions (K, 7, 2, N) have derivatives as well.
        """
        inverse = rotations.transpose(1, 2)
        in_rig = torch.baddbmm(-(inverse @ positions[..., None]), inverse, place)
        cameras = None if photos is None else self._cameras(photos)
        in_camera = self._to_camera(in_rig, cameras)
        # A longer focal length spreads what is beside the optical axis.
        spread = None if log_focal is None else torch.stack((torch.zeros_like(log_focal), log_focal, log_focal)).exp()
        if spread is not None:
            in_camera = in_camera * spread[:, None]
        x, y, z = in_camera.unbind(1)
        flat_square = torch.addcmul(x.square(), y, y)
        flat = flat_square.sqrt()
        sampled = self.level.sample(torch.atan2(y, x), torch.atan2(z, flat), 0 if photos is None else photos)
        # ∂azimuth/∂p = (-y, x, 0) / f² and ∂elevation/∂p = (-x z / f, -y z / f, f) / d², with f² = x² + y² and d² = x² + y² + z².
        square = torch.addcmul(flat_square, z, z).clamp_min_(MIN_DISTANCE_M**2)
        stable = torch.maximum(flat_square, square * MIN_COSINE**2)
        none, over = torch.zeros_like(x), 1 / (flat.clamp_min(1e-6) * square)
        by_point = torch.stack((-y / stable, x / stable, none, -x * z * over, -y * z * over, flat / square), dim=1)
        by_point = by_point.view(len(place), 2, 3, -1)
        by_focal = []
        if spread is not None:
            by_focal = [by_point[:, :, 1] * y[:, None] + by_point[:, :, 2] * z[:, None]]
            by_point = by_point * spread[:, None]
        by_point = self._to_rig(by_point, cameras)  # (K, 2, 3, N)
        # A turn ω and a move τ of the rig take a point q of it to q - ω x q - τ.
        # The cross product by_point x in_rig, plane by plane: the library's own takes several times as long along this axis.
        (a, b, c), (x, y, z) = by_point.unbind(2), in_rig[:, None].unbind(2)
        by_turn = (b * z - c * y, c * x - a * z, a * y - b * x)
        directions = torch.stack((*by_turn, -a, -b, -c, *by_focal), dim=1)  # (K, 6 or 7, 2, N)
        return SampledPoints(sampled[:, :9], directions.contiguous()), sampled[:, 9] > VALID_SHARE

    def _cameras(self, photos: Tensor) -> Tensor:
        """Return planes (12, K, N) of the cameras that points are seen by: rotations, row by row, and centres.

        Planes, because products of a small matrix for each point take several times as long.
        """
        table = torch.cat((self.rotations.flatten(1), self.centers), dim=1).T.contiguous()
        return table.index_select(1, photos.flatten()).view(12, *photos.shape)

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
