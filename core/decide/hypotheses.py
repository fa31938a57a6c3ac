"""Hypotheses: poses on their way through the stages of a method; and how far off they may be."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, PoseDistance
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.refine.refinement import Refined
from panoloc.core.render.comparison import Comparison

_HELD = 0.68  # of the poses are within their radii


@dataclass(frozen=True)
class Hypothesis:
    """One pose of one map, in the index's local frame.

    map_number: which of the query's maps. start: number of the start it came from. rotation: (3, 3) map_from_camera. position: (3,) metres.
    score: of the judge, larger is better. measures: the judge's figures by name.
    loss: robust sampling loss of the last refinement. hessian: (6, 6), its curvature by turn (rad) and move (m) in the camera frame.
    residual_scale: of the last refinement, the residual at which a point counts a quarter. iterations: refinement steps so far.
    color_model: how colours of scan and photo were brought together. is_alias: whether all that the scan shows from here looks as it does
    at the best hypothesis. beyond_limits: whether the images alone would tilt it farther than the limits allow, so that it fits these
    rather than the images. log_focal: logarithm of the factor by which the focal length is longer than that of the rig, None where it is
    as that of the rig; information: of the images of it, as of `Refined`.
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
    is_alias: bool = False
    beyond_limits: bool = False
    log_focal: float | None = None
    information: float = 0.0

    def is_near(self, other: "Hypothesis", near: PoseDistance) -> bool:
        """Tell whether both are the same place and orientation of the same map within the limits."""
        if self.map_number != other.map_number or float((self.position - other.position).norm()) >= near.distance_m:
            return False
        return float(rotation_angle(self.rotation, other.rotation)) < math.radians(near.angle_deg)


@dataclass(frozen=True)
class Accuracy:
    """68 % radii: position (metres) and orientation (degrees); None where a method gives no curvature."""

    position_m: float | None
    orientation_deg: float | None

    def with_noise(self, noise: "Accuracy") -> "Accuracy":
        """Return the radii with further errors, in quadrature."""
        if self.position_m is None or self.orientation_deg is None:
            return self
        position_m = math.hypot(self.position_m, noise.position_m or 0.0)
        return Accuracy(position_m, min(math.hypot(self.orientation_deg, noise.orientation_deg or 0.0), 180.0))

    @property
    def share_right(self) -> float:
        """Return the share of poses with these radii that are right, errors being normal in the plane; 1 where a radius is not known.

        Nothing is surer to be right than its radius allows.
        """
        right = DISTANCES.right
        known = ((right.distance_m, self.position_m), (right.angle_deg, self.orientation_deg))
        shares = [1 - (1 - _HELD) ** ((limit / radius) ** 2) for limit, radius in known if radius]
        return min(shares, default=1.0)


NO_NOISE = Accuracy(0.0, 0.0)


@dataclass(frozen=True)
class MethodResult:
    """What a method returns: hypotheses, best first; the comparison of the best one, where there is any, with its scan at full size; and
    counts for the log.

    edges_deg: how long all edges of photos are together, degrees; None of panoramas and of labels. noise: what tracking and focal length
    add to the errors of the best pose.
    """

    hypotheses: list[Hypothesis]
    comparison: Comparison | None
    num_starts: int
    num_poses: int
    num_rotations: int
    edges_deg: float | None = None
    noise: Accuracy = NO_NOISE


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
    columns = (
        refined.numbers,
        refined.loss,
        refined.scale,
        refined.steps,
        refined.log_focals,
        refined.information,
    )
    # In one piece: each that a GPU is asked for is waited for.
    figures = torch.cat(
        (torch.stack([c.double() for c in columns], dim=1), refined.hessian.double().flatten(1)), 1
    ).cpu()
    return [
        replace(
            group[int(number)],
            rotation=refined.rotations[k],
            position=refined.positions[k],
            loss=loss,
            hessian=figures[k, 6:].view(6, 6),
            log_focal=None if group[int(number)].log_focal is None else log_focal,
            information=information,
            residual_scale=scale,
            iterations=group[int(number)].iterations + int(steps),
        )
        for k, (number, loss, scale, steps, log_focal, information) in enumerate(figures[:, :6].tolist())
    ]


def by_score(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return hypotheses by falling score, leaving out those that are near one before."""
    return distinct(sorted(hypotheses, key=lambda h: -h.score), near)


def merged(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return one hypothesis, that of the smallest loss, for each pose that several have converged to."""
    return distinct(sorted(hypotheses, key=lambda h: h.loss), near)


def within_margin(hypotheses: Sequence[Hypothesis], margin: float) -> list[Hypothesis]:
    """Return those of hypotheses, sorted by falling score, whose scores are within a share `margin` of the best one's."""
    return [h for h in hypotheses if h.score >= (1 - margin) * hypotheses[0].score]


def first_and_elsewhere(hypotheses: Sequence[Hypothesis], count: int, place: PoseDistance) -> list[Hypothesis]:
    """Return the first `count` of hypotheses, best first, and where all of them are at one place, the best one elsewhere.

    How far it is behind says how sure the answer is; and of equal rooms the one that is refined further would seem to fit better.
    """
    kept = list(hypotheses[:count])
    if all(h.is_near(kept[0], place) for h in kept):
        kept += [h for h in hypotheses[count:] if not h.is_near(kept[0], place)][:1]
    return kept


def with_aliases(
    hypotheses: Sequence[Hypothesis], same: Sequence[Hypothesis], near: PoseDistance, least: float
) -> list[Hypothesis]:
    """Return hypotheses, best first, with those marked that are at one of the places `same`, from all of which the scan looks the same,
    where the best is at another of them. What is near the best is not elsewhere, however near it is to one of them as well; and what has
    less than the score `least` only seemed to look the same."""
    if not hypotheses or not any(hypotheses[0].is_near(place, near) for place in same):
        return list(hypotheses)
    best, *rest = hypotheses
    others = [place for place in same if not place.is_near(best, near)]
    is_same = (
        h.score >= least and not h.is_near(best, near) and any(h.is_near(other, near) for other in others) for h in rest
    )
    return [best, *(replace(h, is_alias=flag) for h, flag in zip(rest, is_same, strict=True))]


def distinct(hypotheses: Sequence[Hypothesis], near: PoseDistance) -> list[Hypothesis]:
    """Return hypotheses in the order given, none near one before it that is returned."""
    if not hypotheses:
        return []
    rotations, positions = stacked_poses(hypotheses)
    number = torch.tensor([h.map_number for h in hypotheses], device=rotations.device)
    return [hypotheses[k] for k in first_distinct(rotations, positions, near, number)]
