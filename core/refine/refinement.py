"""Refinement of many candidates at once: Gauss-Newton steps until they converge.

Candidates that no longer move are left where they are, and those that have come together are merged: of 32 candidates that the search
proposes, four tenths still move after 16 steps, and four tenths are the same pose as another (docs/experiments.md).

Paper: §3.3 (refinement of the best candidates).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from panoloc.core.config import PoseDistance, StepConfig, StoppingRule
from panoloc.core.features.line_hold import LineHold
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.image.level import Level
from panoloc.core.refine.patch_sums import PatchSums
from panoloc.core.refine.step import PointPlanes, StepHistory, pose_step


@dataclass(frozen=True)
class CandidatePoints:
    """What each of K candidates aligns: positions (K, N, 3) metres, colors (K, N, 3), weights (K, N) >= 0 (zero: no point).

    images: (K, N) int64, which image of a rig shows each point; None of a rig of one. patches: (N,) int64, ascending, which patch of the
    sphere each point lies in (see `panoloc.core.refine.step`). lines: what edges say of the rotations as well.
    """

    positions: Tensor
    colors: Tensor
    weights: Tensor
    images: Tensor | None
    patches: Tensor
    lines: LineHold | None = None

    def take(self, chosen: Tensor) -> "CandidatePoints":
        """Return the points of the candidates numbered `chosen`."""
        images = None if self.images is None else self.images[chosen]
        lines = None if self.lines is None else self.lines.take(chosen)
        colors, weights = self.colors[chosen], self.weights[chosen]
        return CandidatePoints(self.positions[chosen], colors, weights, images, self.patches, lines)

    def thinned(self, stride: int) -> "CandidatePoints":
        """Return every n-th point."""
        patches = torch.unique(self.patches[::stride], return_inverse=True)[1]
        images = None if self.images is None else self.images[:, ::stride]
        positions, colors, weights = (part[:, ::stride] for part in (self.positions, self.colors, self.weights))
        return CandidatePoints(positions, colors, weights, images, patches, self.lines)

    def planes(self) -> PointPlanes:
        """Return them as planes."""
        positions, colors = self.positions.transpose(1, 2).contiguous(), self.colors.transpose(1, 2).contiguous()
        return PointPlanes(positions, colors, self.weights, self.images, PatchSums(self.patches), self.lines)


def joined(parts: Sequence[CandidatePoints]) -> CandidatePoints:
    """Return the points of several groups of candidates, one group after the other; all with the same number N and patches."""
    images = [part.images for part in parts if part.images is not None]
    lines = [part.lines for part in parts if part.lines is not None]
    return CandidatePoints(
        torch.cat([part.positions for part in parts]),
        torch.cat([part.colors for part in parts]),
        torch.cat([part.weights for part in parts]),
        torch.cat(images) if images else None,
        parts[0].patches,
        LineHold.joined(lines) if lines else None,
    )


@dataclass(frozen=True)
class Refined:
    """Poses after refinement: those of the candidates `numbers` (K,), ascending; the others had come together with one of these.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3). Of the last step: loss (K,) in 0..1; hessian (K, 6, 6) of half the weighted
    squared residuals by turn and move; scale (K,), the residual at which a point counts a quarter. steps: (K,) how many there were.
    """

    numbers: Tensor
    rotations: Tensor
    positions: Tensor
    loss: Tensor
    hessian: Tensor
    scale: Tensor
    steps: Tensor

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
    """Candidates that have not converged: their points, poses, and step history."""

    points: PointPlanes
    poses: Refined
    history: StepHistory

    def take(self, chosen: Tensor) -> "_Active":
        """Return some of the candidates."""
        return _Active(self.points.take(chosen), self.poses.take(chosen), self.history.take(chosen))


def refine(
    level: Level,
    points: CandidatePoints,
    rotations: Tensor,
    positions: Tensor,
    iterations: int,
    config: StepConfig,
    stop: StoppingRule | None = None,
    groups: Tensor | None = None,
    within: Callable[[Tensor], Tensor] | None = None,
) -> Refined:
    """Refine K poses on one image level by up to `iterations` steps, by exactly as many without a rule to stop.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3) metres. groups: (K,), candidates of different groups, such as maps, are never
    merged however near their poses lie; None: all are of one. within: brings rotations (K, 3, 3) back within limits, after every step.
    """
    active = _at_start(points, rotations, positions, config)
    converged: list[Refined] = []
    done = 0
    while done < iterations and len(active.poses.numbers):
        count = min(stop.interval if stop else iterations, iterations - done)
        done += count
        active = _stepped(active, level, config, count, within, is_last=done == iterations)
        if stop and stop.merge and done < iterations:
            converged, active = _without_duplicates(converged, active, stop.merge, groups)
        if stop and done < iterations:
            turn, move = active.history.step[:, :3].norm(dim=-1), active.history.step[:, 3:].norm(dim=-1)
            still = (turn < stop.turn_rad) & (move < stop.move_m)
            converged, active = [*converged, active.poses.take(still)], active.take(~still)
    return Refined.joined([*converged, active.poses])


def _at_start(points: CandidatePoints, rotations: Tensor, positions: Tensor, config: StepConfig) -> _Active:
    nothing = torch.zeros(len(rotations), device=rotations.device)
    numbers = torch.arange(len(rotations), device=rotations.device)
    hessian = torch.zeros((len(rotations), 6, 6), device=rotations.device)
    poses = Refined(numbers, rotations, positions, nothing, hessian, nothing, torch.zeros_like(numbers))
    return _Active(points.planes(), poses, StepHistory.initial(len(rotations), config, rotations.device))


def _stepped(
    active: _Active,
    level: Level,
    config: StepConfig,
    count: int,
    within: Callable[[Tensor], Tensor] | None,
    is_last: bool,
) -> _Active:
    """Take `count` steps; the very last of a refinement is not lengthened."""
    poses, history = active.poses, active.history
    rotations, positions = poses.rotations, poses.positions
    for k in range(count):
        relaxed = not is_last or k + 1 < count
        step = pose_step(level, active.points, rotations, positions, history, config, relaxed)
        rotations, positions, history = step.rotations, step.positions, step.history
        if within is not None:
            rotations = within(rotations)
    found, steps = step.equations, poses.steps + count
    reached = Refined(poses.numbers, rotations, positions, found.loss, found.hessian, found.scale, steps)
    return _Active(active.points, reached, history)


def _without_duplicates(
    converged: list[Refined], active: _Active, near: PoseDistance, groups: Tensor | None
) -> tuple[list[Refined], _Active]:
    """Leave out the candidates that are near one of a smaller loss."""
    together = Refined.joined([*converged, active.poses])
    order = together.loss.argsort()
    rotations, positions = together.rotations[order], together.positions[order]
    of = None if groups is None else groups[together.numbers[order]]
    kept = first_distinct(rotations, positions, near, of)
    numbers = together.numbers[order[torch.tensor(kept, device=order.device)]]
    converged = [part.take(torch.isin(part.numbers, numbers)) for part in converged]
    return converged, active.take(torch.isin(active.poses.numbers, numbers))
