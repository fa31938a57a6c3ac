"""Confidence and error radii: what may move them, and which way."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from panoloc.core.decide.confidence import (
    FEATURES,
    ConfidenceModel,
    RadiusModel,
    alias_margins,
    features_of,
    formal_radii,
    load_confidence_model,
)
from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy, Hypothesis
from tests.core.found_pose import known

FLAT = RadiusModel(0.0, 0.0, 0.0, 0.0, 0.0)
WEIGHTS = {name: 0.1 * (k + 1) for k, name in enumerate(FEATURES)}


def test_confidence_never_falls_with_a_sign_of_agreement_and_grows_with_most() -> None:
    model = load_confidence_model()
    base = dict.fromkeys(FEATURES, 0.2)
    grown = [model.probability(base | {name: 0.4}) - model.probability(base) for name in FEATURES]
    assert min(grown) >= 0
    assert sum(growth > 0 for growth in grown) >= 4
    assert 0 <= model.probability(dict.fromkeys(FEATURES, -1e6)) < 1e-6
    assert 1 - 1e-6 < model.probability(dict.fromkeys(FEATURES, 1e6)) <= 1


def test_the_radii_that_ship_grow_with_the_formal_ones_and_never_fall_with_other_signs_of_an_error() -> None:
    model = load_confidence_model()
    for radius in (model.position_radius, model.orientation_radius):
        assert radius.formal_power > 0
        assert min(radius.halves_power, radius.coverage_power, radius.thickness_power) >= 0
    assert model.alias_power >= 0


def judged(score: float = 1.2, x: float = 0.0, formal_deg: float | None = None, **measures: float) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis with some of the judge's measures, the others 0.1 to 0.5 each.

    formal_deg: its formal radius of orientation.
    """
    names = ("correlation", "patch_correlation", "explained", "relative_coverage", "coverage")
    usual = {name: 0.1 * (k + 1) for k, name in enumerate(names)}
    hessian = None if formal_deg is None else 3 / math.radians(formal_deg) ** 2 * torch.eye(6)
    at = torch.tensor([x, 0.0, 0.0])
    return Hypothesis(0, 0, torch.eye(3), at, score=score, measures=usual | measures, hessian=hessian)


# Features.


@pytest.mark.parametrize(
    ("score", "elsewhere", "share"),
    [
        (0.5, (0.4, 0.1), 0.2),
        (1.5, (0.3, 1.2), 0.2),  # scores of different sizes
        (0.4, (0.5,), -0.25),  # the other place is the better one
        (0.5, (0.1,), 0.5),  # farther behind says nothing more
        (0.5, (2.0,), -0.5),  # nor does farther ahead
        (0.5, (), 0.5),
    ],
)
def test_the_margin_is_the_share_that_the_best_rival_that_is_no_alias_is_behind(
    score: float, elsewhere: tuple[float, ...], share: float
) -> None:
    rivals = [judged(each, 3.0 * k) for k, each in enumerate(elsewhere, 1)]
    alias = replace(judged(0.9 * score, -3.0), is_alias=True)
    assert features_of(judged(score), [alias, *rivals])["margin"] == pytest.approx(share)
    assert alias_margins(judged(score), [alias, *rivals]) == pytest.approx((0.1,))


def test_each_alias_has_a_margin_of_its_own_without_bounds() -> None:
    aliases = [replace(judged(each, 3.0 * k), is_alias=True) for k, each in enumerate((1.0, 1.5, 9.0, 0.1), 1)]
    assert alias_margins(judged(1.25), aliases) == pytest.approx((0.2, -0.2, -6.2, 0.92))
    assert alias_margins(judged(1.25), [judged(1.0, 3.0)]) == ()


def test_what_was_not_measured_is_neither_a_good_sign_nor_a_bad_one() -> None:
    rival = judged(0.9, 3.0)
    found = features_of(judged(), [rival])
    assert tuple(found) == FEATURES
    good: dict[str, Any] = {"lines": 1.0, "halves_apart_m": 0.01, "halves_apart_deg": 0.1}
    bad: dict[str, Any] = {"lines": 0.0, "halves_apart_m": 0.5, "halves_apart_deg": 20.0}
    best = features_of(judged(**good), [rival])
    worst = features_of(judged(**bad), [rival])
    for name in ("halves", "lines"):
        assert worst[name] < found[name] < best[name], name


@pytest.mark.parametrize(
    ("measures", "feature", "sign"),
    [
        ({"patch_correlation": 0.7}, "agreement", 0.7),
        ({"lines": 0.3}, "lines", 0.3),
        # Halves that meet nearer are a better sign.
        ({"halves_apart_m": 0.3, "halves_apart_deg": 0.0}, "halves", 0.0),  # as a right pose may be off
        ({"halves_apart_m": 0.0, "halves_apart_deg": 10.0}, "halves", 0.0),
        ({"halves_apart_m": 0.03, "halves_apart_deg": 0.0}, "halves", math.log(10)),
        ({"halves_apart_m": 0.018, "halves_apart_deg": 0.8}, "halves", math.log(10)),  # both together
        ({"halves_apart_m": 1.2, "halves_apart_deg": 30.0}, "halves", -math.log(5)),
        ({"halves_apart_m": 0.0, "halves_apart_deg": 0.0}, "halves", math.log(1000)),
    ],
)
def test_what_was_measured_is_a_sign(measures: dict[str, float], feature: str, sign: float) -> None:
    found = features_of(judged(**measures), [judged(0.9, 3.0)])
    assert found[feature] == pytest.approx(sign, abs=1e-5)


def test_the_probability_is_the_logistic_function_of_the_weighted_signs() -> None:
    model = ConfidenceModel(0.5, WEIGHTS, 0.0, 0.5, FLAT, FLAT, 0.5)
    features = {name: 1.0 - 0.2 * k for k, name in enumerate(FEATURES)}
    logit = 0.5 + sum(0.1 * (k + 1) * (1.0 - 0.2 * k) for k in range(len(FEATURES)))
    assert model.probability(features) == pytest.approx(1 / (1 + math.exp(-logit)))


@pytest.mark.parametrize(
    ("power", "scores", "share"),
    [
        (5.0, (), 1.0),
        (5.0, (1.2,), 1 / 2),
        (5.0, (1.2, 1.2), 1 / 3),
        (0.0, (0.9, 0.2), 1 / 3),  # nothing tells them apart
        (math.log(3) / 0.25, (0.9,), 3 / 4),  # a quarter behind, a third as probable
        (math.log(3) / 0.25, (0.9, 1.5), 1 / (1 + 1 / 3 + 3)),
    ],
)
def test_the_probability_is_divided_among_places_that_look_the_same_by_powers_of_their_scores(
    power: float, scores: tuple[float, ...], share: float
) -> None:
    model = ConfidenceModel(0.5, WEIGHTS, power, 0.5, FLAT, FLAT, 0.5)
    aliases = [replace(judged(score, 3.0 * k), is_alias=True) for k, score in enumerate(scores, 1)]
    other = judged(1.0, -3.0)
    alone = model.probability(features_of(judged(1.2), [other]))
    assert model.confidence(judged(1.2), [other, *aliases]) == pytest.approx(share * alone)
    # Poses with other focal lengths are as many places more.
    best = judged(1.2, focal_odds=0.5)
    assert model.confidence(best, [other, *aliases]) == pytest.approx(alone / (1 / share + 0.5))


def test_where_the_right_place_may_lie_elsewhere_a_pose_is_as_sure_as_bayes_has_it() -> None:
    model = ConfidenceModel(0.5, WEIGHTS, 0.0, 0.5, FLAT, FLAT, 0.6)
    # What is measured makes a pose six times as probable: 6 * 0.6 / 0.4 = 9 to 1. Of half as many that are right, 6 * 0.3 / 0.7.
    assert model.among(0.9, 0.5) == pytest.approx(1.8 / 2.5)
    assert model.among(0.9, 1.0) == pytest.approx(0.9)
    assert (model.among(0.9, 0.0), model.among(0.0, 0.5), model.among(1.0, 0.5)) == (0.0, 0.0, 1.0)


# Radii.


def test_a_radius_is_a_product_of_powers() -> None:
    model = RadiusModel(log_factor=0.3, formal_power=0.5, halves_power=0.25, coverage_power=2.0, thickness_power=1.5)
    good = math.exp(0.3) * 0.2 * 0.16**0.25 * 100
    assert model.radius(0.04, 0.16, 0.1, 0.004) == pytest.approx(good)
    assert model.radius(0.04, 0.16, 0.1, 0.036) == pytest.approx(27 * good)  # surfaces nine times as thick
    assert model.radius(0.04, 0.16, 0.1, 0.0) == pytest.approx(good)  # thinner ones say nothing more
    assert model.radius(0.0, 1e-9, 1.0, 0.0) == pytest.approx(math.exp(0.3) * 1e-9**0.75)


def test_halves_are_never_nearer_than_the_curvature_allows() -> None:
    model = RadiusModel(log_factor=0.0, formal_power=0.0, halves_power=1.0, coverage_power=0.0, thickness_power=0.0)
    assert model.radius(0.04, 0.001, 1.0, 0.0) == pytest.approx(0.04)


def test_the_accuracy_of_a_pose_has_a_model_for_each_radius_and_the_noise_of_others() -> None:
    position, orientation = RadiusModel(0.0, 1.0, 0.0, 0.0, 1.0), RadiusModel(math.log(2), 0.0, 1.0, 1.0, 0.0)
    model = ConfidenceModel(0.0, {}, 0.0, 0.5, position, orientation, 0.5)
    pose = judged(formal_deg=5.0, halves_apart_m=1.0, halves_apart_deg=6.0, coverage=0.5)
    formal_m, _ = known(formal_radii(pose))

    def radii(of: Hypothesis, noise: Accuracy = NO_NOISE) -> tuple[float, float]:
        found = model.accuracy(of, noise)
        return known(found.position_m), known(found.orientation_deg)

    assert radii(pose) == pytest.approx((formal_m, 24.0))
    assert radii(pose, Accuracy(0.5, 7.0)) == pytest.approx((math.hypot(formal_m, 0.5), 25.0))
    assert radii(replace(pose, measures=pose.measures | {"halves_apart_deg": 100.0}))[1] == 180.0
    assert radii(replace(pose, measures=pose.measures | {"thickness_m": 0.012})) == pytest.approx((3 * formal_m, 24.0))


def test_without_a_curvature_there_is_no_radius_and_without_anything_that_agrees_a_wide_one() -> None:
    model = load_confidence_model()
    assert model.accuracy(judged()) == Accuracy(None, None)
    blind = replace(judged(), hessian=torch.zeros((6, 6)))
    assert known(formal_radii(blind))[0] > 5
    assert model.accuracy(blind).share_right < 0.1


def test_formal_radii_are_those_of_independent_residuals() -> None:
    curvature = torch.diag(torch.tensor([1.0, 4.0, 16.0, 25.0, 100.0, 400.0]))
    hypothesis = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), hessian=curvature, residual_scale=0.2)
    found = known(formal_radii(hypothesis))
    assert found[0] == pytest.approx(0.2 * math.sqrt(1 / 25 + 1 / 100 + 1 / 400), rel=1e-6)
    assert found[1] == pytest.approx(math.degrees(0.2 * math.sqrt(1 + 1 / 4 + 1 / 16)), rel=1e-6)
