"""One resolution of the photos of a rig, to be sampled where points project to.

Each photo has a centre of its own: the parallax between frames that a hand has moved, arm's length and more, is part of the projection.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.panorama.photo_level import PhotoLevel
from core.refine.point_sampling import MIN_COSINE, MIN_DISTANCE_M, VALID_SHARE, SampledPoints


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
        in_camera = self._to_camera(in_rig, photos)
        # A longer focal length spreads what is beside the optical axis.
        spread = None if log_focal is None else torch.stack((torch.zeros_like(log_focal), log_focal, log_focal)).exp()
        if spread is not None:
            in_camera = in_camera * spread[:, None]
        x, y, z = in_camera.unbind(1)
        flat_square = torch.addcmul(x.square(), y, y)
        flat = flat_square.sqrt()
        sampled = self.level.sample(torch.atan2(y, x), torch.atan2(z, flat), photos)
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
        by_point = self._to_rig(by_point, photos)  # (K, 2, 3, N)
        # A turn ω and a move τ of the rig take a point q of it to q - ω x q - τ.
        # The cross product by_point x in_rig, plane by plane: the library's own takes several times as long along this axis.
        (a, b, c), (x, y, z) = by_point.unbind(2), in_rig[:, None].unbind(2)
        by_turn = (b * z - c * y, c * x - a * z, a * y - b * x)
        directions = torch.stack((*by_turn, -a, -b, -c, *by_focal), dim=1)  # (K, 6 or 7, 2, N)
        return SampledPoints(sampled[:, :9], directions.contiguous()), sampled[:, 9] > VALID_SHARE

    def _to_camera(self, in_rig: Tensor, photos: Tensor | None) -> Tensor:
        """Return points of the rig (K, 3, N) in the axes of their cameras."""
        if photos is None:
            return self.rotations[0].T @ (in_rig - self.centers[0, :, None])
        moved = in_rig - self.centers[photos].transpose(1, 2)
        return torch.einsum("knab,kan->kbn", self.rotations[photos], moved)

    def _to_rig(self, vectors: Tensor, photos: Tensor | None) -> Tensor:
        """Return directions (K, 2, 3, N) in the axes of cameras in those of the rig."""
        if photos is None:
            return self.rotations[0] @ vectors
        return torch.einsum("knab,kcbn->kcan", self.rotations[photos], vectors)
