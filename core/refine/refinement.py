"""Refinement of many candidates at once: Gauss-Newton steps until they converge.

Candidates that no longer move are left where they are, and those that have come together are merged: of 32 candidates that the search
proposes, four tenths still move after 16 steps, and four tenths are the same pose as another (docs/experiments.md).

Paper: §3.3 (refinement of the best candidates).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, RefinementConfig, StepConfig, StoppingRule
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.image.level import Level
from panoloc.core.kernels.cuda import has_cuda_kernel
from panoloc.core.refine.patches import on_black_squares
from panoloc.core.refine.step import PointPlanes, PoseStep, pose_steps

NOWHERE = 10.0, math.pi  # metres and radians: how far off poses are of which nothing is known


def joined(parts: Sequence[PointPlanes]) -> PointPlanes:
    """Return the points of several groups of candidates, one group after the other; all with the same patches."""
    if len(parts) == 1:
        return parts[0]
    images = [part.images for part in parts if part.images is not None]
    return PointPlanes(
        torch.cat([part.positions for part in parts]),
        torch.cat([part.colors for part in parts]),
        torch.cat([part.weights for part in parts]),
        torch.cat(images) if images else None,
        parts[0].sums,
    )


@dataclass(frozen=True)
class Refined:
    """Poses after refinement: those of the candidates `numbers` (K,), ascending; the others had come together with one of these.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3). Of the last step: loss (K,) in 0..1; hessian (K, 6, 6) of half the weighted
    squared residuals by turn and move; scale (K,), the residual at which a point counts a quarter. steps: (K,) how many there were.
    log_focals: (K,), logarithms of the factors by which focal lengths are longer than those of the level; information: (K,), the curvature
    of the loss by these where the pose follows, prior included. Both 0 where focal lengths are known.
    """

    numbers: Tensor
    rotations: Tensor
    positions: Tensor
    loss: Tensor
    hessian: Tensor
    scale: Tensor
    steps: Tensor
    log_focals: Tensor
    information: Tensor

    def take(self, chosen: Tensor) -> "Refined":
        """Return some of the candidates."""
        return Refined(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @staticmethod
    def joined(parts: "Sequence[Refined]") -> "Refined":
        """Return the candidates of all parts, in the order of their numbers."""
        if len(parts) == 1:
            return parts[0]
        together = Refined(*(torch.cat([getattr(part, f.name) for part in parts]) for f in fields(Refined)))
        return together.take(together.numbers.argsort())


def refine(
    level: Level,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    iterations: int,
    config: StepConfig,
    stop: StoppingRule | None = None,
    groups: Tensor | None = None,
    within: Callable[[Tensor], Tensor] | None = None,
    log_focals: Tensor | None = None,
    focal_bounds: tuple[float, float] | None = None,
) -> Refined:
    """Refine K poses on one image level by up to `iterations` steps, by exactly as many without a rule to stop.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3) metres. groups: (K,), candidates of different groups, such as maps, are never
    merged however near their poses lie; None: all are of one. within: brings rotations (K, 3, 3) back within limits, after every step.
    log_focals: (K,), focal lengths; within `focal_bounds` they are unknown as well.
    """
    device, nothing = rotations.device, torch.zeros(len(rotations), device=rotations.device)
    numbers, hessian = torch.arange(len(rotations), device=device), torch.zeros((len(rotations), 6, 6), device=device)
    focals, steps = nothing if log_focals is None else log_focals, torch.zeros_like(numbers)
    poses = Refined(numbers, rotations, positions, nothing, hessian, nothing, steps, focals, nothing)
    converged: list[Refined] = []
    done = 0
    # A GPU takes the steps of those that no longer move beside the others; to ask which these are would make it wait.
    all_at_once = stop is None or has_cuda_kernel("pose_steps", rotations)
    while done < iterations and len(poses.numbers):
        count = iterations if all_at_once or stop is None else min(stop.interval, iterations - done)
        done += count
        has_focals, is_last = log_focals is not None, done == iterations
        poses, step = _stepped(points, poses, level, config, count, within, has_focals, focal_bounds, is_last)
        if stop and not is_last:
            converged, left = _without_duplicates(converged, poses, groups)
            moved = step[left]
            turn, move = moved[:, :3].norm(dim=-1), moved[:, 3:].norm(dim=-1)
            still = torch.maximum(turn, move) < stop.pixels * math.pi / level.rows
            converged, moving = [*converged, poses.take(left[still])], left[~still]
            if len(moving) < len(poses.numbers):
                points, poses = points.take(moving), poses.take(moving)
    if stop and all_at_once:
        converged, left = _without_duplicates(converged, poses, groups)
        poses = poses.take(left)
    return Refined.joined([*converged, poses])


def _stepped(
    points: PointPlanes,
    poses: Refined,
    level: Level,
    config: StepConfig,
    count: int,
    within: Callable[[Tensor], Tensor] | None,
    has_focals: bool,
    focal_bounds: tuple[float, float] | None,
    is_last: bool,
) -> tuple[Refined, Tensor]:
    """Take `count` steps; the very last of a refinement is not lengthened. Return the poses, and the last step (K, U)."""
    rotations, positions = poses.rotations, poses.positions
    log_focals = poses.log_focals if has_focals else None
    # Limits are kept after every step.
    at_once = count if within is None else 1
    for k in range(count // at_once):
        has_last = is_last and (k + 1) * at_once == count
        step = pose_steps(level, points, rotations, positions, log_focals, config, focal_bounds, at_once, has_last)
        before = rotations, positions
        rotations, positions, log_focals = step.rotations, step.positions, step.log_focals
        if within is not None:
            rotations = within(rotations)
            is_held = (rotations != step.rotations).flatten(1).any(1, keepdim=True)
            positions = torch.where(is_held, _following(step, *before, rotations, config), positions)
    found, steps = step.equations, poses.steps + count
    focals, information, hessian = poses.log_focals, poses.information, found.hessian
    if log_focals is not None and focal_bounds is not None:
        focals, information = log_focals, _information_of_focal(hessian, found.mass)
    reached = Refined(
        poses.numbers, rotations, positions, found.loss, hessian[:, :6, :6], found.scale, steps, focals, information
    )
    return reached, step.step


def _following(step: PoseStep, before: Tensor, positions: Tensor, rotations: Tensor, config: StepConfig) -> Tensor:
    """Return positions (K, 3), metres, for rotations (K, 3, 3) that limits hold: they solve the equations of the step with the turn that is
    left, where those of the free step make up for a turn that is undone.

    before and positions: the rotations (K, 3, 3) and positions (K, 3) that the step began from.
    """
    turned = before.transpose(1, 2) @ rotations
    taken = step.step.clone()
    taken[:, :3] = torch.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], 1) - turned[:, [1, 2, 0], [2, 0, 1]]
    taken[:, :3] *= 0.5  # turns of a step are small
    taken[:, 3:6] = 0.0
    by_move = step.equations.hessian[:, 3:6]
    right = step.equations.gradient[:, 3:6] + (by_move @ taken[..., None])[..., 0]
    steadied = by_move[:, :, 3:6] + 1e-6 * torch.eye(3, device=right.device)
    move: Tensor = -torch.linalg.solve_ex(steadied, right)[0]
    move = move / (move.norm(dim=1, keepdim=True) / config.max_step_m).clamp_min(1.0)
    return positions + (before @ move[..., None])[..., 0]


def _information_of_focal(hessian: Tensor, mass: Tensor) -> Tensor:
    """Return the curvature (K,) of a loss of unit mass by the last of the unknowns (K, 7, 7) that is left where the others follow it."""
    pose, mixed = hessian[:, :6, :6], hessian[:, :6, 6]
    steadied = pose + torch.diag_embed(torch.diagonal(pose, dim1=-2, dim2=-1) * 1e-4 + 1e-6)
    left: Tensor = hessian[:, 6, 6] - (mixed * torch.linalg.solve_ex(steadied, mixed)[0]).sum(-1)
    return left.clamp_min(0.0) / mass


def _without_duplicates(
    converged: list[Refined], poses: Refined, groups: Tensor | None
) -> tuple[list[Refined], Tensor]:
    """Leave out the candidates near one of a smaller loss; return the converged ones that are left, and the numbers of others that are."""
    if not converged and len(poses.numbers) == 1:
        return converged, torch.zeros_like(poses.numbers)
    together = Refined.joined([*converged, poses])
    order = together.loss.argsort()
    rotations, positions = together.rotations[order], together.positions[order]
    of = None if groups is None else groups[together.numbers[order]]
    kept = torch.tensor(first_distinct(rotations, positions, DISTANCES.same, of), dtype=torch.long, device=order.device)
    numbers = together.numbers[order[kept]]
    converged = [part.take(torch.isin(part.numbers, numbers).nonzero()[:, 0]) for part in converged]
    return converged, torch.isin(poses.numbers, numbers).nonzero()[:, 0]


def halves_apart(
    level: Level,
    points: PointPlanes,
    rotation: Tensor,
    position: Tensor,
    log_focals: Tensor | None,
    square_deg: float,
    config: RefinementConfig,
) -> Tensor:
    """Return how far apart (2,), metres and radians, the poses are that the two halves of a picture, refined apart, lead to from one pose.

    At the right pose all parts of a picture say the same, however little some of them still agree. At a wrong one what fits does so by
    chance, and each half alone fits better elsewhere: by decimetres and degrees in rooms as bare as they come, where all other signs may be
    taken in (docs/confidence.md).

    The halves are the black and the white squares of a chessboard on the sphere. points: of that one pose. rotation: (3, 3)
    map_from_camera; position: (3,) metres.
    """
    directions = torch.nn.functional.normalize((points.positions[0].T - position) @ rotation, dim=-1)
    is_black = on_black_squares(directions, square_deg)
    weights = points.weights[0] * torch.stack((is_black, ~is_black))
    both = replace(points.take(torch.zeros(2, dtype=torch.long, device=weights.device)), weights=weights)
    focals = None if log_focals is None else log_focals.expand(2)
    found = refine(
        level,
        both,
        rotation.expand(2, 3, 3),
        position.expand(2, 3),
        config.iterations,
        config.step,
        log_focals=focals,
    )
    distance = (found.positions[0] - found.positions[1]).norm()
    angle = rotation_angle(found.rotations[0], found.rotations[1])
    # Halves in which nothing agrees stay where they are, which is no agreement.
    is_blind = (found.hessian.diagonal(dim1=1, dim2=2).sum(-1) <= 0).any()
    return torch.stack((torch.where(is_blind, NOWHERE[0], distance), torch.where(is_blind, NOWHERE[1], angle)))
