"""The verdict over judged hypotheses, by a model whose coefficients are those of no fit."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.decide.confidence import FEATURES, ConfidenceModel, RadiusModel
from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy, Hypothesis
from panoloc.core.decide.verdict import Verdict, is_elsewhere, verdict
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Status
from tests.core.painted_box import rotation_of

# What agrees by 0.9 is sure to 4 alone, in logits, and to 0.847 at the threshold; what a rival takes of it depends on how near it comes; an
# alias takes a share.
WEIGHTS = {"agreement": 10.0, "margin": 8.0}
RADIUS = RadiusModel(0.0, 1.0, 0.0, 0.0, 0.0)
MODEL = ConfidenceModel(-9.0, dict.fromkeys(FEATURES, 0.0) | WEIGHTS, 4.0, 0.7, RADIUS, RADIUS, 0.5)
ALONE = 1 / (1 + math.exp(-4.0))


def judged(x: float, score: float, fits: float = 0.9) -> Hypothesis:
    """Return a hypothesis at a place whose images agree by `fits`."""
    measures = {"correlation": fits, "patch_correlation": fits, "relative_coverage": 1.0, "coverage": 0.9}
    return Hypothesis(0, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=score, measures=measures)


def judge(*hypotheses: Hypothesis, noise: Accuracy = NO_NOISE) -> Verdict:
    return verdict(hypotheses, MODEL, noise)


def test_a_place_that_fits_far_better_than_all_others_is_localized() -> None:
    found = judge(judged(0.0, 1.8), judged(3.0, 0.6, 0.3))
    assert (found.status, found.num_equals) == ("localized", 1)
    assert found.confidences == pytest.approx([ALONE, 1 - ALONE])


def alias(x: float, score: float, fits: float = 0.9) -> Hypothesis:
    """Return a hypothesis at a place from which all looks as from the best one."""
    return replace(judged(x, score, fits), is_alias=True)


def test_two_places_that_look_alike_are_ambiguous() -> None:
    found = judge(judged(0.0, 1.8), alias(3.0, 1.8))
    assert (found.status, found.num_equals) == ("ambiguous", 2)
    assert found.confidences == pytest.approx([ALONE / 2] * 2)


def test_two_places_that_fit_alike_but_look_different_are_no_answer() -> None:
    # One of them fits by chance at least, so the other may.
    found = judge(judged(0.0, 1.8), judged(3.0, 1.79))
    assert (found.status, found.num_equals) == ("not_localized", 1)


def test_aliases_share_by_their_scores_and_the_rest_comes_last_and_stays_improbable() -> None:
    found = judge(judged(0.0, 1.8), alias(3.0, 1.8), judged(12.0, 0.5, 0.2), alias(6.0, 1.8 * (1 + math.log(0.5) / 4)))
    assert (found.status, found.num_equals) == ("ambiguous", 3)
    assert [float(place.position[0]) for place in found.places] == [0.0, 3.0, 6.0, 12.0]
    shares = [1 / 2.5, 1 / 2.5, 0.5 / 2.5]
    assert found.confidences == pytest.approx([*(share * ALONE for share in shares), 1 - ALONE])


@pytest.mark.parametrize("fits", [0.3, 0.58])
def test_aliases_that_would_not_be_right_alone_are_no_answer(fits: float) -> None:
    assert judge(judged(0.0, 1.8, fits), alias(3.0, 1.79, fits)).status == "not_localized"


def test_aliases_are_no_answer_where_another_place_fits_nearly_as_well() -> None:
    assert judge(judged(0.0, 1.8), alias(3.0, 1.8), judged(6.0, 1.78)).status == "not_localized"


@pytest.mark.parametrize(("behind", "status"), [(0.08, "not_localized"), (0.13, "localized")])
@pytest.mark.parametrize("score", [0.45, 1.8])
def test_how_far_a_place_is_ahead_counts_as_a_share_of_its_score(score: float, behind: float, status: str) -> None:
    assert judge(judged(0.0, score), judged(3.0, (1 - behind) * score)).status == status


def test_poses_of_one_place_are_no_rivals() -> None:
    found = judge(judged(0.0, 1.8), judged(0.1, 1.79))
    assert found.status == "localized"
    assert [float(place.position[0]) for place in found.places] == [pytest.approx(0.0)]


@pytest.mark.parametrize(
    ("is_alias", "least_behind", "nearer"),
    [
        (False, 0.847 / 8, "not_localized"),  # as far as a pose must be ahead: what the model gives, solved by hand
        (True, 0.909 / 4, "ambiguous"),  # 0.982 / 0.7 = 1 + exp(-0.909)
    ],
)
def test_a_rival_must_be_farther_behind_where_it_is_an_alias(is_alias: bool, least_behind: float, nearer: str) -> None:
    for behind, status in ((least_behind - 0.01, nearer), (least_behind + 0.01, "localized")):
        assert judge(judged(0.0, 1.0), replace(judged(3.0, 1 - behind), is_alias=is_alias)).status == status


def test_aliases_that_only_together_make_it_unsure_are_equals() -> None:
    aliases = [alias(x, 1 + math.log(0.3) / 4) for x in (3.0, 6.0)]
    for rival in aliases:
        assert judge(judged(0.0, 1.0), rival).status == "localized"
    found = judge(judged(0.0, 1.0), *aliases)
    assert (found.status, found.num_equals) == ("ambiguous", 3)
    assert found.confidences == pytest.approx([ALONE / 1.6, *[0.3 * ALONE / 1.6] * 2])


@pytest.mark.parametrize(("noise_m", "status"), [(0.0, "localized"), (0.28, "localized"), (0.5, "not_localized")])
def test_a_pose_is_no_surer_than_its_radius_and_the_noise_allow(noise_m: float, status: str) -> None:
    sharp = replace(judged(0.0, 1.8), hessian=1e4 * torch.eye(6), residual_scale=0.1)
    found = judge(sharp, noise=Accuracy(noise_m, 0.0))
    assert found.status == status
    assert found.accuracy.position_m == pytest.approx(math.hypot(noise_m, 0.1 * math.sqrt(3e-4)), rel=1e-4)
    assert found.confidences[0] == pytest.approx(min(ALONE, found.accuracy.share_right))


def test_a_pose_whose_radius_is_wider_than_what_is_right_is_not_localized() -> None:
    found = judge(replace(judged(0.0, 1.8), hessian=0.01 * torch.eye(6), residual_scale=0.1))
    assert found.status == "not_localized"
    assert found.confidences[0] < 0.3


def test_what_fits_the_limits_rather_than_the_images_is_never_localized_nor_ambiguous() -> None:
    beyond = replace(judged(0.0, 1.8), beyond_limits=True)
    for others in ((), (alias(3.0, 1.79),)):
        found = judge(beyond, *others)
        assert found.status == "not_localized"
        assert found.confidences[0] <= MODEL.threshold / 2
    # Of rivals nothing was asked but where they are.
    assert judge(judged(0.0, 1.8), replace(judged(3.0, 0.2), beyond_limits=True)).status == "localized"


@pytest.mark.parametrize("fits", [0.3, 0.6, 0.75, 0.9])
def test_no_other_place_is_surer_than_the_answer_and_together_they_are_one(fits: float) -> None:
    # The best place by other signs than those of which the rest is measured.
    others = [judged(3.0 * k, 1.9 - 0.3 * k, 0.95) for k in (1, 2, 3)]
    found = judge(judged(0.0, 1.8, fits), *others)
    assert max(found.confidences) == found.confidences[0]
    assert sum(found.confidences) <= 1 + 1e-9


def test_no_alias_is_surer_than_the_answer_and_no_other_place_surer_than_an_alias() -> None:
    found = judge(judged(0.0, 1.8), alias(3.0, 1.6), alias(6.0, 1.9), judged(9.0, 1.5))
    best, behind, ahead, other = found.confidences
    assert found.status == "ambiguous"
    assert best == ahead > behind == other


@pytest.mark.parametrize(
    ("status", "off_m", "off_deg", "radius_m", "answer"),
    [
        ("localized", 0.29, 0.0, 0.05, False),
        ("localized", 0.31, 0.0, 0.05, True),
        ("localized", 0.0, 9.0, 0.05, False),
        ("localized", 0.0, 11.0, 0.05, True),
        ("localized", 0.45, 0.0, 0.25, False),  # by chance
        ("not_localized", 2.0, 0.0, 0.05, False),  # nobody knows
    ],
)
def test_an_image_is_elsewhere_that_is_surely_farther_off_than_right_poses_are(
    status: Status, off_m: float, off_deg: float, radius_m: float, answer: bool
) -> None:
    alone = Verdict([judged(0.0, 1.8)], [0.9], status, Accuracy(radius_m, 1.0))
    expected = Pose(np.eye(3), np.zeros(3))
    assert is_elsewhere(alone, Pose(rotation_of(off_deg), np.array([0.0, off_m, 0.0])), expected) == answer
