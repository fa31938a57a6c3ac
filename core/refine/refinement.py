"""Refinement of many candidates at once: Gauss-Newton steps until poses rest.

Candidates that no longer move are left where they are, and those that have come together go on as one: of 32 candidates that the search
proposes, four tenths still move after 16 steps, and four tenths are the same pose as another (docs/experiments.md).

Paper: §3.3 (refinement of the best candidates).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from core.config import Rest
from core.geometry.distinct_poses import first_distinct
from core.panorama.image_level import ImageLevel
from core.refine.gauss_newton import Aligned, Pace, StepRules, first_pace, gauss_newton_step


@dataclass(frozen=True)
class CandidatePoints:
    """What each of K candidates aligns: positions (K, N, 3) metres, colors (K, N, 3), weights (K, N) >= 0 (zero: no point)."""

    positions: Tensor
    colors: Tensor
    weights: Tensor

    def take(self, chosen: Tensor) -> "CandidatePoints":
        """Return the points of the candidates numbered `chosen`."""
        return CandidatePoints(self.positions[chosen], self.colors[chosen], self.weights[chosen])

    def planes(self) -> Aligned:
        """Return them as planes."""
        place, target = self.positions.transpose(1, 2).contiguous(), self.colors.transpose(1, 2).contiguous()
        return Aligned(place, target, self.weights)


def joined(parts: Sequence[CandidatePoints]) -> CandidatePoints:
    """Return the points of several groups of candidates, one group after the other; all with the same number N."""
    return CandidatePoints(
        torch.cat([part.positions for part in parts]),
        torch.cat([part.colors for part in parts]),
        torch.cat([part.weights for part in parts]),
    )


@dataclass(frozen=True)
class Refined:
    """Poses after refinement: those of the candidates `numbers` (K,), ascending; the others had come together with one of these.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3). Of the last step: loss (K,) in 0..1; hessian (K, 6, 6) of half the weighted
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
class _Moving:
    """Candidates on their way: their points, and the weights (K, N) and pace of the last step."""

    points: Aligned
    light_weights: Tensor
    poses: Refined
    pace: Pace

    def take(self, chosen: Tensor) -> "_Moving":
        """Return some of the candidates."""
        points = Aligned(self.points.place[chosen], self.points.target[chosen], self.points.weights[chosen])
        return _Moving(points, self.light_weights[chosen], self.poses.take(chosen), self.pace.take(chosen))


def refine(
    level: ImageLevel,
    points: CandidatePoints,
    rotations: Tensor,
    positions: Tensor,
    iterations: int,
    rules: StepRules,
    rest: Rest | None = None,
    groups: Tensor | None = None,
) -> Refined:
    """Refine K poses on one image level by up to `iterations` steps, all of them without a `rest`.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3) metres. groups: (K,), candidates of different groups, such as maps, are never
    one however near their poses lie; None: all are of one.
    """
    moving = _at_start(points, rotations, positions, rules)
    resting: list[Refined] = []
    done = 0
    while done < iterations and len(moving.light_weights):
        count = min(rest.interval if rest else iterations, iterations - done)
        done += count
        moving = _walked(moving, level, rules, count, to_the_end=done == iterations)
        if rest and done < iterations:
            resting, moving = _parted(resting, moving, rest, groups)
    return Refined.joined([*resting, moving.poses])


def _at_start(points: CandidatePoints, rotations: Tensor, positions: Tensor, rules: StepRules) -> _Moving:
    planes = points.planes()
    nothing = torch.zeros(len(rotations), device=rotations.device)
    numbers = torch.arange(len(rotations), device=rotations.device)
    hessian = torch.zeros((len(rotations), 6, 6), device=rotations.device)
    poses = Refined(numbers, rotations, positions, nothing, hessian, nothing, torch.zeros_like(numbers))
    return _Moving(planes, planes.weights, poses, first_pace(len(rotations), rules, rotations.device))


def _walked(moving: _Moving, level: ImageLevel, rules: StepRules, count: int, to_the_end: bool) -> _Moving:
    """Take `count` steps; the very last of a refinement is not lengthened."""
    poses, light_weights, pace = moving.poses, moving.light_weights, moving.pace
    rotations, positions = poses.rotations, poses.positions
    for k in range(count):
        relaxed = not to_the_end or k + 1 < count
        step = gauss_newton_step(level, moving.points, rotations, positions, light_weights, pace, rules, relaxed)
        rotations, positions, light_weights, pace = step.rotations, step.positions, step.weights, step.pace
    reached = Refined(poses.numbers, rotations, positions, step.loss, step.hessian, step.scale, poses.steps + count)
    return _Moving(moving.points, light_weights, reached, pace)


def _parted(
    resting: list[Refined], moving: _Moving, rest: Rest, groups: Tensor | None
) -> tuple[list[Refined], _Moving]:
    """Let those rest that hardly moved, and leave out those that are near a better one."""
    if rest.apart_m > 0:
        together = Refined.joined([*resting, moving.poses])
        order = together.loss.argsort()
        rotations, positions = together.rotations[order], together.positions[order]
        of = None if groups is None else groups[together.numbers[order]]
        kept = first_distinct(rotations, positions, rest.apart_m, math.degrees(rest.apart_rad), of)
        numbers = together.numbers[order[torch.tensor(kept, device=order.device)]]
        resting = [part.take(torch.isin(part.numbers, numbers)) for part in resting]
        moving = moving.take(torch.isin(moving.poses.numbers, numbers))
    turn, move = moving.pace.step[:, :3].norm(dim=-1), moving.pace.step[:, 3:].norm(dim=-1)
    rests = (turn < rest.turn_rad) & (move < rest.move_m)
    return [*resting, moving.poses.take(rests)], moving.take(~rests)
