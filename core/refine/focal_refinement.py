"""Refinement of a pose together with the focal length of the photos.

A wider picture of a nearer wall looks almost the same, so pose and focal length pull against each other, and only steps that move both
at once come to rest. The focal length is a seventh unknown of the equations of `panoloc.core.refine.step`:
aligned patch by patch, a room of which much has changed still tells it. How sharply it does is told as well, for a
photo of one wall may not tell it at all.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import StepConfig
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.level import Level
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.step import patch_equations

_MAX_STEP = 0.08  # of the logarithm of the focal length
_DAMPING = 0.02


@dataclass(frozen=True)
class FocalRefined:
    """A pose of the rig, map_from_rig: rotation (3, 3) and position (3,) metres; log_factor (), the logarithm of the factor by which the
    focal length is longer than that of the level; information: (), the second derivative of the loss by it, where the pose follows."""

    rotation: Tensor
    position: Tensor
    log_factor: Tensor
    information: Tensor

    @classmethod
    def at(cls, rotation: Tensor, position: Tensor) -> "FocalRefined":
        """Return a pose with the focal length of the level, of which nothing is known yet."""
        nothing = torch.zeros((), device=position.device)
        return cls(rotation, position, nothing, nothing)

    @property
    def strength(self) -> float:
        """Return how strongly the photos want another focal length than that of the level: how far off it is, against what they know."""
        return float(self.log_factor.abs() * self.information.sqrt())


def refine_with_focal(
    level: Level, points: CandidatePoints, begun: FocalRefined, iterations: int, config: StepConfig
) -> FocalRefined:
    """Move the pose of a rig and the focal length of all its photos by Gauss-Newton steps.

    points: of one candidate, K = 1, that lie in patches. begun: where steps begin.
    """
    planes = points.planes()
    rotation, position, log_factor = begun.rotation, begun.position, begun.log_factor
    information = begun.information
    for _ in range(iterations):
        found = patch_equations(level, planes, rotation[None], position[None], config, log_factor)
        hessian, gradient = found.hessian[0], found.gradient[0]
        information = _of_focal_alone(hessian) / found.mass[0]
        damped = hessian + torch.diag(torch.diagonal(hessian) * _DAMPING + 1e-6)
        step = -torch.linalg.solve(damped, gradient)
        # Shortened as a whole: a part of it alone would leave the valley that pose and focal length share.
        turn, move, spread = step[:3], step[3:6], step[6]
        longest = torch.stack(
            (turn.norm() / config.max_turn_rad, move.norm() / config.max_move_m, spread.abs() / _MAX_STEP)
        )
        step = step / longest.amax().clamp_min(1.0)
        position = position + rotation @ step[3:6]
        rotation = rotation @ rotation_from_vector(step[None, :3])[0]
        log_factor = log_factor + step[6]
    return FocalRefined(rotation, position, log_factor, information)


def _of_focal_alone(hessian: Tensor) -> Tensor:
    """Return the curvature () by the last of the unknowns (7, 7) that is left where the others follow it."""
    pose, mixed = hessian[:6, :6], hessian[:6, 6]
    steadied = pose + torch.diag(torch.diagonal(pose) * 1e-4 + 1e-6)
    left: Tensor = hessian[6, 6] - mixed @ torch.linalg.solve(steadied, mixed)
    return left.clamp_min(0.0)
