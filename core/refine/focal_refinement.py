"""Refinement of a pose together with the focal length of a photo that nobody knows.

A wider picture of a nearer wall looks almost the same, so pose and focal length pull against each other, and only steps that move both
at once come to rest. The focal length is a seventh unknown: where a point is looked up, it is spread from the optical axis by a factor.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.config import StepConfig
from core.geometry.rotations import rotation_from_vector
from core.light.light_fit import fit_planes
from core.refine.gauss_newton import normal_equations
from core.refine.point_sampling import SampledPoints
from core.refine.refinement import CandidatePoints
from core.refine.rig_level import RigLevel

_MAX_STEP = 0.05  # of the logarithm of the focal length


@dataclass(frozen=True)
class FocalRefined:
    """A pose of the rig, map_from_rig: rotation (3, 3) and position (3,) metres; and by which factor the focal length is longer than that
    of the level."""

    rotation: Tensor
    position: Tensor
    focal_factor: float


def refine_with_focal(
    level: RigLevel, points: CandidatePoints, begun: FocalRefined, iterations: int, config: StepConfig
) -> FocalRefined:
    """Move the pose of a rig of one photo and its focal length by Gauss-Newton steps.

    points: of one candidate, K = 1. begun: where steps begin.
    """
    planes = points.planes()
    weights, rotation, position = planes.weights, begun.rotation, begun.position
    log_factor = torch.tensor(begun.focal_factor, device=position.device).log()
    for _ in range(iterations):
        seen, inside = _sampled(level, planes.positions, rotation, position, log_factor)
        base = planes.weights * inside
        if config.fit_light:
            seen.apply_gain_offset(*fit_planes(seen.color, planes.colors, weights * inside))
        residual = seen.color - planes.colors
        squared = residual.square().sum(1)
        median = squared[base > 0].median() if bool((base > 0).any()) else squared.new_ones(())
        scale = (config.robust_scale * median.sqrt()).clamp_min(config.min_residual)
        weights = base / (1 + squared / scale.square()).square()
        hessian, gradient = normal_equations(seen, residual, weights, config.fit_light)
        damping = torch.diagonal(hessian[0]) * config.damping + 1e-6
        update = -torch.linalg.solve(hessian[0] + torch.diag(damping), gradient[0])
        # Shortened as a whole: a part of it alone would leave the valley that pose and focal length share.
        turn, move, spread = update[:3], update[3:6], update[6]
        longest = max(
            float(turn.norm()) / config.max_turn_rad,
            float(move.norm()) / config.max_move_m,
            abs(float(spread)) / _MAX_STEP,
            1.0,
        )
        position = position + rotation @ (move / longest)
        rotation = rotation @ rotation_from_vector((turn / longest)[None])[0]
        log_factor = log_factor + spread / longest
    return FocalRefined(rotation, position, float(log_factor.exp()))


def _sampled(
    level: RigLevel, place: Tensor, rotation: Tensor, position: Tensor, log_factor: Tensor
) -> tuple[SampledPoints, Tensor]:
    """Sample points (1, 3, N) as `RigLevel.sample_points`, with a seventh derivative, by the logarithm of the focal length."""
    forward = level.rotations[0, :, 0]
    in_rig = rotation.T @ (place[0] - position[:, None]) - level.centers[0, :, None]
    ahead = torch.outer(forward, forward @ in_rig)
    beside = (in_rig - ahead) * log_factor.exp()
    none = torch.zeros_like(position)[None]
    same = torch.eye(3, device=place.device)[None]
    seen, inside = level.sample_points((ahead + beside + level.centers[0, :, None])[None], None, same, none)
    by_point = -seen.directions[0, 3:]  # (3, 2, N), by the point as it is looked up
    by_spread = (by_point * beside[:, None]).sum(0)
    along = torch.einsum("a,acn->cn", forward, by_point)
    by_point = (by_point - forward[:, None, None] * along) * log_factor.exp() + forward[:, None, None] * along
    x, y, z = (in_rig + level.centers[0, :, None])[:, None].unbind(0)
    a, b, c = by_point.unbind(0)
    directions = torch.stack((b * z - c * y, c * x - a * z, a * y - b * x, -a, -b, -c, by_spread))
    return SampledPoints(seen.planes, directions[None].contiguous()), inside
