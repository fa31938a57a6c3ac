"""Doubts that turn an answer for photos into none, and say why."""

from dataclasses import replace

import numpy as np
import pytest

from core.config import JudgeConfig
from core.geometry.pose import Pose
from core.judge.doubts import Doubts
from core.options import Status
from core.results import Candidate, Localization, SearchSummary

DOUBTS = Doubts(JudgeConfig(), 0.6)


def found(status: Status) -> Localization:
    best = Candidate(Pose(np.eye(3), np.zeros(3)), 0, 0.95, 1.0, 0.1, "equalized", 40)
    return Localization(status, SearchSummary("fast", 1, 10, 100, 1000), {}, best=best)


@pytest.mark.parametrize("status", ["localized", "ambiguous"])
def test_an_image_without_edges_is_nowhere(status: Status) -> None:
    answer = DOUBTS.unless_plain(found(status), 20.0)
    assert answer.status == "not_localized"
    assert answer.best is not None
    assert answer.best.confidence == 0.3
    (words,) = answer.warnings
    assert "plain wall" in words


@pytest.mark.parametrize("edges_deg", [None, 400.0])
def test_an_image_with_edges_or_of_labels_is_left_alone(edges_deg: float | None) -> None:
    before = found("localized")
    assert DOUBTS.unless_plain(before, edges_deg) is before


def test_what_is_not_localized_needs_no_doubt() -> None:
    before = found("not_localized")
    assert DOUBTS.unless_plain(before, 0.0) is before


def test_a_bound_of_the_field_of_view_is_named() -> None:
    answer = DOUBTS.unless_at_bound(found("localized"), 80.0)
    assert answer.status == "not_localized"
    assert answer.warnings == (
        "the photo fits best when it is 80 degrees wide, a bound of hfov_range_deg; widen the range",
    )
    assert DOUBTS.unless_at_bound(found("localized"), None).warnings == ()


def test_of_what_fits_nowhere_a_bound_is_no_reason_but_a_hint() -> None:
    (words,) = DOUBTS.unless_at_bound(found("not_localized"), 80.0).warnings
    assert words.startswith("nothing fits well enough")
    assert "80 degrees" in words


def test_an_answer_that_is_refused_is_no_less_sure_than_its_alternatives() -> None:
    best = found("localized").best
    assert best is not None
    answer = DOUBTS.unless_plain(replace(found("localized"), alternatives=(replace(best, confidence=0.5),)), 0.0)
    assert answer.best is not None
    assert answer.alternatives[0].confidence == answer.best.confidence == 0.3


def test_what_an_uncertain_focal_length_leaves_open_bounds_the_confidence() -> None:
    known = replace(found("localized"), accuracy_position_m=0.28, accuracy_orientation_deg=1.0)
    answer = DOUBTS.unless_focal_length_matters(known)
    assert answer.status == "localized"
    assert answer.best is not None
    assert 0.6 < answer.best.confidence < 0.8
    assert answer.warnings == ()


def test_a_focal_length_that_leaves_too_much_open_is_no_answer() -> None:
    blurred = replace(found("localized"), accuracy_position_m=0.5, accuracy_orientation_deg=1.0)
    answer = DOUBTS.unless_focal_length_matters(blurred)
    assert answer.status == "not_localized"
    (words,) = answer.warnings
    assert "field of view" in words
    assert "0.50 m" in words
