"""What speaks for a pose that a person sets: nothing, the points that were clicked, or the engine; and the doubts, in words."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import PoseError
from panoloc.core.remarks import Reason, Remark
from panoloc.core.survey.resection import LEAST_PAIRS, Resection, suspect_words
from panoloc.service.answer import Accuracy, Localization

LEVEL = 0.68
BY_HAND = Remark("placed_by_hand", "a person has placed this photo")
_UNMEASURED = Remark(
    "placed_by_hand",
    "the pose is as it was set by hand: nothing says how accurate it is; points clicked in photo and scan would",
)
_RIGHT_M, _RIGHT_DEG = 0.3, 10.0  # what `confidence` of an answer is about
_MOST_OF_PAIRS = 0.95  # geometry knows nothing of points that were mistaken for others
_MOST_UNCOMPARED = 0.8
_RADIUS_68 = 1.08  # of a spread in three dimensions, to its root mean square
_AWAY = 3.0  # times the residuals of the clicked points, from which on a refined pose contradicts them
_AWAY_PX = 10.0
_OUTSIDE_M = 0.5  # from which on a camera is not just at the edge of the scan


@dataclass(frozen=True)
class Evidence:
    """What speaks for a pose. agreement: of photo and scan, −1..1. confidence: as of an answer; 0 where nothing measures it."""

    agreement: float | None
    confidence: float
    accuracy: Accuracy | None
    warnings: list[Remark]


UNMEASURED = Evidence(None, 0.0, None, [_UNMEASURED])
"""Of a pose that was set by hand alone."""


def of_pairs(solved: Sequence[Resection], num_pairs: int) -> Evidence:
    """Return what pairs say for the first of the poses that they leave."""
    first = solved[0]
    words = [] if first.suspect is None else [suspect_words(first.suspect)]
    if len(solved) > 1:
        span_m = max(float(np.linalg.norm(each.pose.position - first.pose.position)) for each in solved)
        words.append(
            f"the points fit {len(solved)} places, up to {span_m:.1f} m apart; click one more to decide between them"
        )
    elif num_pairs == LEAST_PAIRS:
        words.append(
            "three points always fit, even wrong ones, so nothing says how accurate the pose is; click a fourth"
        )
    remarks = [Remark("placed_by_hand", each) for each in words]
    if num_pairs == LEAST_PAIRS:
        return Evidence(None, 0.0, None, remarks)
    accuracy = Accuracy(position_m=first.radius_m, orientation_deg=first.radius_deg, level=LEVEL)
    right = _share_within(_RIGHT_M, first.radius_m) * _share_within(_RIGHT_DEG, first.radius_deg) / len(solved)
    return Evidence(None, round(min(right, _MOST_OF_PAIRS), 4), accuracy, remarks)


def uncompared(pairs: Evidence) -> Evidence:
    """Return what pairs say where the engine has not compared photo and scan: points that agree may all be mistaken for others."""
    if pairs.confidence <= _MOST_UNCOMPARED:
        return pairs
    words = (
        "photo and scan were not compared there, and points that agree may still be the wrong ones; compare them by eye"
    )
    return replace(pairs, confidence=_MOST_UNCOMPARED, warnings=[*pairs.warnings, Remark("placed_by_hand", words)])


def of_engine(answer: Localization) -> Evidence:
    """Return what the engine says for the pose to which it has refined one. It was given that as a hint, which nobody has sent."""
    said = zip(answer.reasons, answer.warnings, strict=True)
    remarks = [Remark(reason, words) for reason, words in said if reason != "widen_hints"]
    if answer.status != "localized":
        words = "photo and scan agree too little there for an answer of the search; compare them by eye"
        remarks.append(Remark("placed_by_hand", words))
    return Evidence(answer.images[0].agreement, answer.confidence, answer.accuracy, remarks)


def checked(pairs: Evidence, answer: Localization, moved: PoseError) -> Evidence:
    """Return what pairs say for a pose once the engine has compared photo and scan around it; moved: from it to the refined pose."""
    same = moved.within(_RIGHT_M, _RIGHT_DEG) or answer.status != "localized"
    most = round(answer.confidence if same else 1 - answer.confidence, 4)
    if pairs.confidence <= most:
        return pairs
    words = (
        "photo and scan agree too little there"
        if same
        else f"photo and scan agree better {moved.position_m:.2f} m and {moved.orientation_deg:.0f} degrees from there"
    )
    remark = Remark(
        "placed_by_hand", f"{words}; the accuracy is that of the clicks, and holds only if they show the right points"
    )
    return replace(pairs, confidence=most, warnings=[*pairs.warnings, remark])


def outside(position: NDArray[np.float64], bounds: Mapping[str, Sequence[float]] | None) -> list[Remark]:
    """Return a remark where a camera lies outside of the scan, of these bounds."""
    if bounds is None:
        return []
    away_m = float(np.linalg.norm(position - np.clip(position, bounds["min"], bounds["max"])))
    if away_m < _OUTSIDE_M:
        return []
    return [Remark("placed_by_hand", f"the pose lies {away_m:.1f} m outside of the scan; check its position and frame")]


def contradictions(given_px: Sequence[float] | None, refined_px: Sequence[float] | None) -> list[Remark]:
    """Return a remark where the refined pose does not see the clicked points where they were clicked; residuals in pixels."""
    if given_px is None or refined_px is None:
        return []
    before, after = (math.sqrt(float(np.square(each).mean())) for each in (given_px, refined_px))
    if after <= _AWAY * before + _AWAY_PX:
        return []
    words = f"the refined pose is {after:.0f} px off the clicked points, the solved one {before:.0f} px"
    return [Remark("placed_by_hand", f"{words}; if the points are right, confirm the solved pose")]


def by_reason(remarks: Sequence[Remark]) -> list[Remark]:
    """Return remarks with those of the same reason made one, as programs take them."""
    words: dict[Reason, list[str]] = {}
    for each in remarks:
        words.setdefault(each.reason, []).append(each)
    return [Remark(reason, "; ".join(texts)) for reason, texts in words.items()]


def _share_within(limit: float, radius_68: float) -> float:
    """Return the probability that an error in three dimensions, of which 68 % are within a radius, is within a limit."""
    ratio = limit / max(radius_68 / _RADIUS_68 / math.sqrt(3), 1e-9)
    return math.erf(ratio / math.sqrt(2)) - math.sqrt(2 / math.pi) * ratio * math.exp(-(ratio**2) / 2)
