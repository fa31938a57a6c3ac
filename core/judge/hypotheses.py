"""Hypotheses: poses on their way through the stages of a method."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from core.geometry.distinct_poses import first_distinct
from core.geometry.rotations import rotation_angle
from core.views.comparison import Comparison
from core.views.render_cloud import RenderCloud

# Poses further apart than either of these are different answers.
ELSEWHERE_M, ELSEWHERE_DEG = 0.5, 15.0


@dataclass(frozen=True)
class Hypothesis:
    """One pose of one map, in the index's local frame.

    map_number: which of the query's maps. start: number of the start it came from. rotation: (3, 3) map_from_camera. position: (3,) metres.
    score: of the judge, larger is better. measures: the judge's figures by name.
    loss: robust sampling loss of the last refinement. hessian: (6, 6), its curvature by turn (rad) and move (m) in the camera frame.
    residual_scale: of the last refinement, the residual at which a point counts a quarter. iterations: refinement steps so far.
    color_model: how colours of scan and photo were brought together.
    """

    map_number: int
    start: int
    rotation: Tensor
    position: Tensor
    score: float = 0.0
    measures: dict[str, float] = field(default_factory=dict)
    loss: float = math.inf
    hessian: Tensor | None = None
    residual_scale: float = 1.0
    iterations: int = 0
    color_model: str = "equalized"

    def is_near(self, other: "Hypothesis", distance_m: float, angle_deg: float) -> bool:
        """Tell whether both are the same place and orientation within the limits."""
        if self.map_number != other.map_number or float((self.position - other.position).norm()) >= distance_m:
            return False
        return float(rotation_angle(self.rotation, other.rotation)) < math.radians(angle_deg)


@dataclass(frozen=True)
class MethodResult:
    """What a method returns: hypotheses, best first; the comparison of the best one with its scan at full size; and counts for the log."""

    hypotheses: list[Hypothesis]
    comparison: Comparison | None
    cloud: RenderCloud | None
    num_starts: int
    num_poses: int


def by_map(hypotheses: Sequence[Hypothesis]) -> Iterator[tuple[int, list[Hypothesis]]]:
    """Yield each map's number with its hypotheses, in the order given."""
    numbers = dict.fromkeys(h.map_number for h in hypotheses)
    for number in numbers:
        yield number, [h for h in hypotheses if h.map_number == number]


def stacked_poses(hypotheses: Sequence[Hypothesis]) -> tuple[Tensor, Tensor]:
    """Return rotations (K, 3, 3) and positions (K, 3)."""
    return torch.stack([h.rotation for h in hypotheses]), torch.stack([h.position for h in hypotheses])


def best_distinct(
    hypotheses: Sequence[Hypothesis], count: int, distance_m: float = 0.15, angle_deg: float = 4.0
) -> list[Hypothesis]:
    """Return up to `count` hypotheses by falling score, leaving out those that converged to one already taken."""
    return _first_distinct(sorted(hypotheses, key=lambda h: -h.score), count, distance_m, angle_deg)


def converged(hypotheses: Sequence[Hypothesis], distance_m: float = 0.1, angle_deg: float = 3.0) -> list[Hypothesis]:
    """Return one hypothesis, that of the smallest loss, for each pose that several have converged to."""
    return _first_distinct(sorted(hypotheses, key=lambda h: h.loss), len(hypotheses), distance_m, angle_deg)


def promising(hypotheses: Sequence[Hypothesis], count: int, margin: float) -> list[Hypothesis]:
    """Return up to `count` of hypotheses that are sorted by falling score: those within `margin` of the best, and the best one elsewhere.

    That one cannot win, but how far it is behind says how sure the answer is.
    """
    if not hypotheses:
        return []
    best = hypotheses[0]
    kept = [h for h in hypotheses[:count] if h.score >= best.score - margin]
    if all(h.is_near(best, ELSEWHERE_M, ELSEWHERE_DEG) for h in kept):
        kept += [h for h in hypotheses[len(kept) :] if not h.is_near(best, ELSEWHERE_M, ELSEWHERE_DEG)][:1]
    return kept


def _first_distinct(
    hypotheses: Sequence[Hypothesis], count: int, distance_m: float, angle_deg: float
) -> list[Hypothesis]:
    """Return up to `count` hypotheses in the order given, none near one before it."""
    if not hypotheses:
        return []
    rotations, positions = stacked_poses(hypotheses)
    number = torch.tensor([h.map_number for h in hypotheses], device=rotations.device)
    return [hypotheses[k] for k in first_distinct(rotations, positions, distance_m, angle_deg, number, count)]


def distinct_places(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Keep hypotheses in their order, leaving out those at the place of one before."""
    places: list[Hypothesis] = []
    for hypothesis in hypotheses:
        if not any(hypothesis.is_near(place, ELSEWHERE_M, ELSEWHERE_DEG) for place in places):
            places.append(hypothesis)
    return places
