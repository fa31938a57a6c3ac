"""Refinement of many candidates at once: Gauss-Newton steps until they converge.

Candidates that no longer move are left where they are, and those that have come together are merged: of 32 candidates that the search
proposes, four tenths still move after 16 steps, and four tenths are the same pose as another (docs/experiments.md).

Paper: §3.3 (refinement of the best candidates).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, StepConfig, StoppingRule
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.image.level import Level
from panoloc.core.kernels.cuda import has_cuda_kernel
from panoloc.core.refine.step import PointPlanes, pose_steps


def joined(parts: Sequence[PointPlanes]) -> PointPlanes:
    """Return the points of several groups of candidates, one group after the other; all with the same patches."""
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
        together = Refined(*(torch.cat([getattr(part, f.name) for part in parts]) for f in fields(Refined)))
        return together.take(together.numbers.argsort())


@dataclass(frozen=True)
class _Active:
    """Candidates that have not converged: their points, poses, and last step (K, U); and whether focal lengths differ from the level's."""

    points: PointPlanes
    poses: Refined
    step: Tensor
    has_focals: bool

    def take(self, chosen: Tensor) -> "_Active":
        """Return some of the candidates."""
        return _Active(self.points.take(chosen), self.poses.take(chosen), self.step[chosen], self.has_focals)


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
    active = _at_start(points, rotations, positions, log_focals, focal_bounds)
    converged: list[Refined] = []
    done = 0
    # A GPU takes the steps of those that no longer move beside the others; to ask which these are would make it wait.
    all_at_once = stop is None or has_cuda_kernel("pose_steps", rotations)
    while done < iterations and len(active.poses.numbers):
        count = iterations if all_at_once or stop is None else min(stop.interval, iterations - done)
        done += count
        active = _stepped(active, level, config, count, within, focal_bounds, is_last=done == iterations)
        if stop and done < iterations:
            converged, active = _without_duplicates(converged, active, groups)
            turn, move = active.step[:, :3].norm(dim=-1), active.step[:, 3:].norm(dim=-1)
            still = torch.maximum(turn, move) < stop.pixels * math.pi / level.rows
            if bool(still.any()):
                converged = [*converged, active.poses.take(still.nonzero()[:, 0])]
                active = active.take((~still).nonzero()[:, 0])
    if stop and all_at_once:
        converged, active = _without_duplicates(converged, active, groups)
    return Refined.joined([*converged, active.poses])


def _at_start(
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    log_focals: Tensor | None,
    focal_bounds: tuple[float, float] | None,
) -> _Active:
    nothing = torch.zeros(len(rotations), device=rotations.device)
    numbers = torch.arange(len(rotations), device=rotations.device)
    hessian = torch.zeros((len(rotations), 6, 6), device=rotations.device)
    focals = nothing if log_focals is None else log_focals
    poses = Refined(
        numbers, rotations, positions, nothing, hessian, nothing, torch.zeros_like(numbers), focals, nothing
    )
    step = torch.zeros((len(rotations), 6 if focal_bounds is None else 7), device=rotations.device)
    return _Active(points, poses, step, log_focals is not None)


def _stepped(
    active: _Active,
    level: Level,
    config: StepConfig,
    count: int,
    within: Callable[[Tensor], Tensor] | None,
    focal_bounds: tuple[float, float] | None,
    is_last: bool,
) -> _Active:
    """Take `count` steps; the very last of a refinement is not lengthened."""
    poses = active.poses
    rotations, positions = poses.rotations, poses.positions
    log_focals = poses.log_focals if active.has_focals else None
    # Limits are kept after every step.
    at_once = count if within is None else 1
    for k in range(count // at_once):
        has_last = is_last and (k + 1) * at_once == count
        step = pose_steps(
            level, active.points, rotations, positions, log_focals, config, focal_bounds, at_once, has_last
        )
        rotations, positions, log_focals = step.rotations, step.positions, step.log_focals
        if within is not None:
            rotations = within(rotations)
    found, steps = step.equations, poses.steps + count
    focals, information, hessian = poses.log_focals, poses.information, found.hessian
    if log_focals is not None and focal_bounds is not None:
        focals, information = log_focals, _information_of_focal(hessian, found.mass)
    reached = Refined(
        poses.numbers, rotations, positions, found.loss, hessian[:, :6, :6], found.scale, steps, focals, information
    )
    return _Active(active.points, reached, step.step, active.has_focals)


def _information_of_focal(hessian: Tensor, mass: Tensor) -> Tensor:
    """Return the curvature (K,) of a loss of unit mass by the last of the unknowns (K, 7, 7) that is left where the others follow it."""
    pose, mixed = hessian[:, :6, :6], hessian[:, :6, 6]
    steadied = pose + torch.diag_embed(torch.diagonal(pose, dim1=-2, dim2=-1) * 1e-4 + 1e-6)
    left: Tensor = hessian[:, 6, 6] - (mixed * torch.linalg.solve_ex(steadied, mixed)[0]).sum(-1)
    return left.clamp_min(0.0) / mass


def _without_duplicates(
    converged: list[Refined], active: _Active, groups: Tensor | None
) -> tuple[list[Refined], _Active]:
    """Leave out the candidates that are near one of a smaller loss."""
    together = Refined.joined([*converged, active.poses])
    order = together.loss.argsort()
    rotations, positions = together.rotations[order], together.positions[order]
    of = None if groups is None else groups[together.numbers[order]]
    kept = first_distinct(rotations, positions, DISTANCES.same, of)
    if len(kept) == len(order):
        return converged, active
    numbers = together.numbers[order[torch.tensor(kept, device=order.device)]]
    converged = [part.take(torch.isin(part.numbers, numbers).nonzero()[:, 0]) for part in converged]
    return converged, active.take(torch.isin(active.poses.numbers, numbers).nonzero()[:, 0])
