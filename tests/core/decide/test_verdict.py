"""The verdict over judged hypotheses."""

from dataclasses import replace

import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.decide.verdict import verdict

MODEL, CONFIG = load_confidence_model(), JudgeConfig()


def judged(x: float, score: float, fits: float) -> Hypothesis:
    """Return a hypothesis at a place whose measures all say how well it fits."""
    measures = {"correlation": fits, "patch_correlation": fits, "inlier_share": fits, "coverage": 0.9}
    return Hypothesis(0, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=score, measures=measures)


def test_a_place_that_fits_far_better_than_all_others_is_localized() -> None:
    found = verdict([judged(0.0, 1.8, 0.9), judged(3.0, 0.6, 0.3)], MODEL, CONFIG)
    assert found.status == "localized"
    assert found.confidences[0] > MODEL.threshold > found.confidences[1]


def test_two_places_that_fit_alike_are_ambiguous() -> None:
    found = verdict([judged(0.0, 1.8, 0.9), judged(3.0, 1.79, 0.9)], MODEL, CONFIG)
    assert found.status == "ambiguous"
    assert len(found.places) == 2
    assert found.confidences[0] == found.confidences[1] <= 0.5


def test_of_three_equals_each_is_a_third_and_the_rest_stays_improbable() -> None:
    equals = [judged(3.0 * k, 1.8 - 0.01 * k, 0.9) for k in range(3)]
    found = verdict([*equals, judged(12.0, 0.5, 0.2)], MODEL, CONFIG)
    assert found.status == "ambiguous"
    assert sum(found.confidences[:3]) <= 1
    assert found.confidences[0] == found.confidences[2] > found.confidences[3]


def test_of_small_scores_a_smaller_difference_tells_two_places_apart() -> None:
    # As of photos: 0.08 of 0.45 is more than 0.08 of 1.8.
    clear, alike = (verdict([judged(0.0, 0.45, 0.9), judged(3.0, rival, 0.9)], MODEL, CONFIG) for rival in (0.37, 0.4))
    assert (clear.status, alike.status) == ("localized", "ambiguous")
    assert verdict([judged(0.0, 1.8, 0.9), judged(3.0, 1.72, 0.9)], MODEL, CONFIG).status == "ambiguous"


def test_poses_of_one_place_are_no_rivals() -> None:
    found = verdict([judged(0.0, 1.8, 0.9), judged(0.1, 1.79, 0.9)], MODEL, CONFIG)
    assert found.status == "localized"
    assert [float(place.position[0]) for place in found.places] == [pytest.approx(0.0)]


def test_a_pose_that_was_held_back_is_never_sure() -> None:
    held_back = replace(judged(0.0, 1.8, 0.9), is_held_back=True)
    for rivals in ([], [judged(3.0, 1.79, 0.9)]):
        found = verdict([held_back, *rivals], MODEL, CONFIG)
        assert found.status == "not_localized"
        assert found.confidences[0] < MODEL.threshold


@pytest.mark.parametrize(
    ("likeness", "rival", "status"),
    [
        (0.9, 0.36, "ambiguous"),  # they look the same: 20 % is no difference
        (0.9, 0.3, "localized"),  # one third is
        (0.7, 0.36, "localized"),  # they hardly look the same: 20 % is a difference
        (0.7, 0.41, "ambiguous"),
        (0.4, 0.41, "localized"),  # they do not: as much of the photo fits there by chance, which the margin knows
        (None, 0.41, "ambiguous"),
        (None, 0.36, "localized"),
    ],
)
def test_how_alike_two_places_look_decides_by_how_much_they_must_differ(
    likeness: float | None, rival: float, status: str
) -> None:
    other = replace(judged(3.0, rival, 0.9), likeness=None if likeness is None else likeness * 0.45)
    assert verdict([judged(0.0, 0.45, 0.9), other], MODEL, CONFIG).status == status


@pytest.mark.parametrize(("rival", "status"), [(0.28, "ambiguous"), (0.26, "localized")])
def test_where_all_of_the_scan_looks_the_same_a_photo_must_tell_much_more(rival: float, status: str) -> None:
    # Though what the photo shows of both looks so little alike that it would tell them apart elsewhere.
    other = replace(judged(3.0, rival, 0.9), likeness=0.5 * 0.45, is_same_view=True)
    assert verdict([judged(0.0, 0.45, 0.9), other], MODEL, CONFIG).status == status
    assert verdict([judged(0.0, 0.45, 0.9), replace(other, is_same_view=False)], MODEL, CONFIG).status == "localized"


def test_that_equals_resemble_each_other_does_not_count_against_them() -> None:
    best = judged(0.0, 0.45, 0.5)
    best = replace(best, measures=best.measures | {"distinctness": 0.0})
    equal, other = replace(judged(3.0, 0.44, 0.5), likeness=0.45), replace(judged(6.0, 0.1, 0.2), likeness=0.09)
    found = verdict([best, other, equal], MODEL, CONFIG)
    assert found.status == "ambiguous"
    assert [float(place.position[0]) for place in found.places] == [0.0, 3.0, 6.0]
    assert found.together == pytest.approx(2 * found.confidences[0]) == pytest.approx(2 * found.confidences[1])
    as_far = replace(other, likeness=0.45)
    assert verdict([best, as_far, equal], MODEL, CONFIG).together < found.together


def test_a_pose_whose_radius_is_wider_than_what_is_right_is_not_localized() -> None:
    sharp, wide = (
        replace(judged(0.0, 1.8, 0.9), hessian=torch.eye(6) * curvature, residual_scale=0.1)
        for curvature in (1e4, 0.01)
    )
    assert verdict([sharp], MODEL, CONFIG).status == "localized"
    found = verdict([wide], MODEL, CONFIG)
    assert found.status == "not_localized"
    assert found.confidences[0] < 0.3


@pytest.mark.parametrize("fits", [0.3, 0.6, 0.9])
def test_no_other_place_is_surer_than_the_answer_and_together_they_are_one(fits: float) -> None:
    # The best place by other signs than those of which the rest is measured.
    others = [judged(3.0 * k, 1.9 - 0.3 * k, 0.95) for k in (1, 2, 3)]
    for best in (judged(0.0, 1.8, fits), replace(judged(0.0, 1.8, fits), is_held_back=True)):
        found = verdict([best, *others], MODEL, CONFIG)
        assert max(found.confidences) == found.confidences[0]
        assert sum(found.confidences) <= 1 + 1e-9
