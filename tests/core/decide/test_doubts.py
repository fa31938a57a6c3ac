"""Rules that reject an answer for photos, and say why."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.agreement import PhotoAgreement
from panoloc.core.decide.verdict import Doubts
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Status
from panoloc.core.results import Candidate, Localization, SearchSummary
from tests.core.found_pose import known

DOUBTS = Doubts(JudgeConfig(), 0.6)


def candidate(confidence: float) -> Candidate:
    return Candidate(Pose(np.eye(3), np.zeros(3)), 0, confidence, 1.0, 0.1, "equalized", 40)


def found(status: Status = "localized") -> Localization:
    return Localization(status, SearchSummary("fast", 1, 10, 100, 1000), {}, best=candidate(0.95))


def photos(agreements: list[float | None]) -> list[PhotoAgreement | None]:
    """Return photos that show much, and agree so much with the pose of all of them, everywhere alike."""
    return [None if each is None else PhotoAgreement(each, 0.2 * float(each >= 0.5), 0.3) for each in agreements]


@pytest.mark.parametrize(
    ("agreements", "before", "after", "warning"),
    [
        ([0.9, 0.8, 0.5, 0.7], "localized", "localized", ""),
        # One of four, and not the one whose pose is the answer.
        (
            [0.9, 0.35, 0.5, 0.7],
            "localized",
            "localized",
            "image 2 of 4 does not agree with the pose that fits the others",
        ),
        ([0.9, 0.35, 0.5, 0.7, 0.1, 0.8], "localized", "localized", "images 2 and 5 of 6 do not agree"),
        ([0.9, 0.35, 0.5], "localized", "localized", "image 2 of 3 does not agree"),
        ([0.35, 0.9, 0.5, 0.7], "localized", "not_localized", "image 1 of 4"),
        ([0.9, 0.05, 0.08, 0.9], "localized", "not_localized", "images 2 and 3 of 4 do not agree"),
        ([0.9, None, None, 0.9], "localized", "localized", ""),  # nothing of the scan in view is no contradiction
        ([0.1], "localized", "localized", ""),  # alone it has nothing to contradict
        ([0.5, 0.9, 0.1, -0.1], "not_localized", "not_localized", "images 3 and 4 of 4 do not agree"),
        # What lies outside spoils the fit of the others, and is named in their place where nothing is found.
        ([0.9, None, 0.1, 0.9], "not_localized", "not_localized", "image 2 of 4 would lie outside of the scan"),
        ([0.35, None, None, 0.7], "localized", "not_localized", "images 2 and 3 of 4 would lie outside of the scan"),
        ([0.9, None, 0.35, 0.9], "localized", "localized", "image 3 of 4 does not agree"),
        ([0.4, 0.1, 0.0, -0.1], "not_localized", "not_localized", ""),  # all of another place
    ],
)
def test_more_than_a_few_images_that_disagree_or_the_first_make_a_session_unsure(
    agreements: list[float | None], before: Status, after: Status, warning: str
) -> None:
    answer = DOUBTS.unless_contradicted(found(before), photos(agreements), lambda: False)
    assert answer.status == after
    assert (known(answer.best).confidence < 0.5) == (before == "localized" and after == "not_localized")
    assert [words.startswith(warning) for words in answer.warnings] == ([True] if warning else [])


@pytest.mark.parametrize(
    ("explained", "is_asked"),
    [
        ([0.2, 0.3, 0.3], True),
        ([0.3, 0.3, 0.3], True),
        ([0.3, 0.2, 0.3], False),  # another fits worse
        ([None, 0.3, 0.3], True),  # not compared
        ([0.3, None, None], True),  # nothing else was
        ([0.01, 0.3, 0.3], False),  # contradicts at once
    ],
)
def test_a_first_image_that_fits_worst_is_asked_where_it_is_by_itself(
    explained: list[float | None], is_asked: bool
) -> None:
    agreements = [None if each is None else PhotoAgreement(0.7, each, 0.3) for each in explained]
    asked = []

    def elsewhere(answer: bool) -> bool:
        asked.append(answer)
        return answer

    kept = DOUBTS.unless_contradicted(found(), agreements, lambda: elsewhere(False))
    refused = DOUBTS.unless_contradicted(found(), agreements, lambda: elsewhere(True))
    DOUBTS.unless_contradicted(
        found("not_localized"), agreements, lambda: elsewhere(True)
    )  # what is lost needs no other doubt
    assert asked == [False, True] * is_asked
    contradicts = explained[0] is not None and explained[0] < 0.05
    assert kept.status == ("not_localized" if contradicts else "localized")
    assert refused.status == ("not_localized" if contradicts or is_asked else "localized")
    assert [remark.reason for remark in refused.warnings] == ["images_contradict"] * (contradicts or is_asked)


def test_the_more_images_contradict_the_less_sure_is_what_is_left() -> None:
    answer = DOUBTS.unless_contradicted(found(), photos([0.9, 0.1, 0.1, 0.1]), lambda: False)
    assert known(answer.best).confidence == pytest.approx(0.95 / 4)


@pytest.mark.parametrize(
    ("before", "edges_deg", "after"),
    [
        ("localized", 20.0, "not_localized"),
        ("ambiguous", 20.0, "not_localized"),
        ("not_localized", 0.0, "not_localized"),
        ("localized", 400.0, "localized"),
        ("localized", None, "localized"),  # labels have no edges
    ],
)
def test_an_image_without_edges_is_nowhere(before: Status, edges_deg: float | None, after: Status) -> None:
    answer = DOUBTS.unless_plain(replace(found(before), alternatives=(candidate(0.5),)), edges_deg)
    assert answer.status == after
    assert ["plain wall" in words for words in answer.warnings] == [True] * (before != after)
    if before != after:  # and no less sure than its alternatives
        assert answer.alternatives[0].confidence == known(answer.best).confidence == 0.3


def test_a_bound_of_the_field_of_view_is_named() -> None:
    answer = DOUBTS.unless_at_bound(found(), 80.0)
    said = "the photo fits best when it is 80 degrees wide, a bound of the range (hfov_range_deg, --hfov); widen it"
    assert (answer.status, answer.warnings) == ("not_localized", (said,))
    assert DOUBTS.unless_at_bound(found(), None).warnings == ()
    # Where nothing fits, the bound is no reason but a hint.
    (words,) = DOUBTS.unless_at_bound(found("not_localized"), 80.0).warnings
    assert words.startswith("nothing fits well enough")
    assert {remark.reason for remark in (*answer.warnings, words)} == {"widen_hfov_range"}
