"""Hypotheses: poses on their way through the stages of a method."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from panoloc.core.config import PoseDistance
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.refine.refinement import Refined
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.render_cloud import RenderCloud


@dataclass(frozen=True)
class Hypothesis:
    """One pose of one map, in the index's local frame.

    map_number: which of the query's maps. start: number of the start it came from. rotation: (3, 3) map_from_camera. position: (3,) metres.
    score: of the judge, larger is better. measures: the judge's figures by name.
    loss: robust sampling loss of the last refinement. hessian: (6, 6), its curvature by turn (rad) and move (m) in the camera frame.
    residual_scale: of the last refinement, the residual at which a point counts a quarter. iterations: refinement steps so far.
    color_model: how colours of scan and photo were brought together. is_held_back: whether the last refinement left what hints or
    gravity allow and was turned back, so that the pose fits them rather than the picture. likeness: to the best hypothesis, the score
    that the scan as photos would show it here has beside the scan as they would show it there; None where it was not measured.
    is_same_view: whether all that the scan shows from here looks as it does at the best hypothesis.
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
    is_held_back: bool = False
    likeness: float | None = None
    is_same_view: bool = False

    def is_near(self, other: "Hypothesis", near: PoseDistance) -> bool:
        """Tell whether both are the same place and orientation of the same map within the limits."""
        if self.map_number != other.map_number or float((self.position - other.position).norm()) >= near.distance_m:
            return False
        return float(rotation_angle(self.rotation, other.rotation)) < math.radians(near.angle_deg)


@dataclass(frozen=True)
class MethodResult:
    """What a method returns: hypotheses, best first; the comparison of the best one with its scan at full size; and counts for the log.

    edges_deg: how long all edges of photos are together, degrees; None of panoramas and of labels. focal_pull: how strongly photos want
    another focal length at the best pose (see `panoloc.core.fast.camera_check`).
    """

    hypotheses: list[Hypothesis]
    comparison: Comparison | None
    cloud: RenderCloud | None
    num_starts: int
    num_poses: int
    edges_deg: float | None = None
    focal_pull: float = 0.0


def by_map(hypotheses: Sequence[Hypothesis]) -> Iterator[tuple[int, list[Hypothesis]]]:
    """Yield each map's number with its hypotheses, in the order given."""
    numbers = dict.fromkeys(h.map_number for h in hypotheses)
    for number in numbers:
        yield number, [h for h in hypotheses if h.map_number == number]


def stacked_poses(hypotheses: Sequence[Hypothesis]) -> tuple[Tensor, Tensor]:
    """Return rotations (K, 3, 3) and positions (K, 3)."""
    return torch.stack([h.rotation for h in hypotheses]), torch.stack([h.position for h in hypotheses])


def with_refined(group: Sequence[Hypothesis], refined: Refined) -> list[Hypothesis]:
    """Return those hypotheses of a group (K) that refinement left, with their new poses and what the last step told of them."""
    columns = (refined.numbers, refined.loss, refined.scale, refined.steps)
    return [
        replace(
            group[int(number)],
            rotation=refined.rotations[k],
            position=refined.positions[k],
            loss=loss,
            hessian=refined.hessian[k],
            residual_scale=scale,
            iterations=group[int(number)].iterations + int(steps),
        )
        for k, (number, loss, scale, steps) in enumerate(torch.stack([c.double() for c in columns], dim=1).tolist())
    ]


def by_score(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return hypotheses by falling score, leaving out those that are near one before."""
    return distinct(sorted(hypotheses, key=lambda h: -h.score), near)


def merged(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return one hypothesis, that of the smallest loss, for each pose that several have converged to."""
    return distinct(sorted(hypotheses, key=lambda h: h.loss), near)


def within_margin(
    hypotheses: Sequence[Hypothesis], count: int, margin: float, place: PoseDistance | None = None
) -> list[Hypothesis]:
    """Return up to `count` of hypotheses that are sorted by falling score: those within `margin` of the best.

    place: where all of them are at one place, the best one elsewhere is kept as well. It cannot win, but how far it is behind says how
    sure the answer is.
    """
    kept = [h for h in hypotheses[:count] if h.score >= hypotheses[0].score - margin]
    if place is not None and all(h.is_near(kept[0], place) for h in kept):
        kept += [h for h in hypotheses[len(kept) :] if not h.is_near(kept[0], place)][:1]
    return kept


def with_close_rival(
    hypotheses: Sequence[Hypothesis], count: int, margin: float, place: PoseDistance
) -> list[Hypothesis]:
    """Return up to `count` of hypotheses that are sorted by falling score, those within `margin` of the best; and the best one at
    another place, where it is within the margin too: of equal rooms the one that is refined further would seem to fit better.
    """
    within = [h for h in hypotheses if h.score >= hypotheses[0].score - margin]
    kept = within[:count]
    if all(h.is_near(kept[0], place) for h in kept):
        kept += [h for h in within[count:] if not h.is_near(kept[0], place)][:1]
    return kept


def with_same_views(
    hypotheses: Sequence[Hypothesis], same: Sequence[Hypothesis], near: PoseDistance
) -> list[Hypothesis]:
    """Return hypotheses, best first, with those marked that are at one of the places `same`, from all of which the scan looks the same,
    where the best is at another of them. What is near the best is not elsewhere, however near it is to one of them as well."""
    if not hypotheses or not any(hypotheses[0].is_near(place, near) for place in same):
        return list(hypotheses)
    best, *rest = hypotheses
    others = [place for place in same if not place.is_near(best, near)]
    is_same = (not h.is_near(best, near) and any(h.is_near(other, near) for other in others) for h in rest)
    return [best, *(replace(h, is_same_view=flag) for h, flag in zip(rest, is_same, strict=True))]


def distinct(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return hypotheses in the order given, none near one before it that is returned."""
    if not hypotheses:
        return []
    rotations, positions = stacked_poses(hypotheses)
    number = torch.tensor([h.map_number for h in hypotheses], device=rotations.device)
    return [hypotheses[k] for k in first_distinct(rotations, positions, near, number)]


def with_distinctness(best: Hypothesis, elsewhere: Sequence[Hypothesis]) -> Hypothesis:
    """Return the best hypothesis with one more measure, by how much less its place resembles any of the others than what was photographed:
    0, at least as much, to 1, not at all. Without that measure where nobody knows.
    """
    measures = {name: value for name, value in best.measures.items() if name != "distinctness"}
    found = [h.likeness for h in elsewhere if h.likeness is not None]
    if found and best.score > 0:
        measures["distinctness"] = 1 - min(1.0, max(0.0, max(found) / best.score))
    return replace(best, measures=measures)
