"""Confidence and error radii: what may move them, and which way."""

import math
from typing import Any

import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.confidence import (
    FEATURES,
    ConfidenceModel,
    RadiusModel,
    error_radii,
    features_of,
    formal_radii,
    load_confidence_model,
    share_within,
)
from panoloc.core.decide.hypotheses import Hypothesis
from tests.core.found_pose import known

CONFIG = JudgeConfig()


def test_confidence_never_falls_with_a_sign_of_agreement_and_grows_with_most() -> None:
    model = load_confidence_model()
    base = dict.fromkeys(FEATURES, 0.2)
    grown = [model.probability(base | {name: 0.4}) - model.probability(base) for name in FEATURES]
    assert min(grown) >= 0
    assert sum(growth > 0 for growth in grown) >= 4
    assert 0 <= model.probability(dict.fromkeys(FEATURES, -1e6)) < 1e-6
    assert 1 - 1e-6 < model.probability(dict.fromkeys(FEATURES, 1e6)) <= 1


@pytest.mark.parametrize("axis", [0, 1], ids=["position", "orientation"])
def test_radii_grow_with_the_distance_of_halves_and_shrink_with_what_is_seen(axis: int) -> None:
    model = load_confidence_model()

    def radius(apart: float, coverage: float) -> float:
        measures = {"halves_apart_m": 0.01 * apart, "halves_apart_deg": 0.1 * apart, "coverage": coverage}
        return known(error_radii((0.01, 0.1), measures, model)[axis])

    assert radius(10.0, 0.1) > radius(2.0, 0.1) > radius(2.0, 0.9)


def test_without_a_curvature_there_is_no_error_radius() -> None:
    hypothesis = Hypothesis(0, 0, torch.eye(3), torch.zeros(3))
    assert error_radii(formal_radii(hypothesis), {}, load_confidence_model()) == (None, None)


def judged(score: float = 1.2, **measures: float) -> Any:
    """Return a hypothesis with some of the judge's measures, the others 0.1 to 0.5 each."""
    names = ("correlation", "patch_correlation", "mutual_information", "inlier_share", "coverage")
    usual = {name: 0.1 * (k + 1) for k, name in enumerate(names)}
    return Hypothesis(0, 0, torch.eye(3), torch.zeros(3), score=score, measures=usual | measures)


@pytest.mark.parametrize(
    ("score", "best_elsewhere", "share"),
    [
        (0.5, 0.4, 0.2),
        (1.5, 1.2, 0.2),  # photos and panoramas have scores of different sizes
        (0.4, 0.5, 0.0),  # the other place is the better one
        (-0.1, 0.2, 0.0),
        (0.5, 0.0, 0.2),  # nobody knows
    ],
)
def test_the_relative_margin_is_the_share_that_the_best_other_place_is_behind(
    score: float, best_elsewhere: float, share: float
) -> None:
    found = features_of(judged(score), best_elsewhere, None, CONFIG)
    assert found["relative_margin"] == pytest.approx(share)


def test_what_was_not_measured_is_neither_a_good_sign_nor_a_bad_one() -> None:
    found = features_of(judged(), 0.9, None, CONFIG)
    assert tuple(found) == FEATURES
    assert found["patch_correlation"] == pytest.approx(0.2)
    unknown = {name: getattr(CONFIG, f"unknown_{name}") for name in ("distinctness", "halves", "sharpness", "lines")}
    assert {name: found[name] for name in unknown} == unknown


@pytest.mark.parametrize(
    ("measures", "formal_deg", "feature", "sign"),
    [
        ({"distinctness": 0.8}, None, "distinctness", 0.8),
        ({"lines": 0.3}, None, "lines", 0.3),
        # Halves that meet nearer are a better sign.
        ({"halves_apart_m": 0.3, "halves_apart_deg": 0.0}, None, "halves", 0.0),  # as a right pose may be off
        ({"halves_apart_m": 0.0, "halves_apart_deg": 10.0}, None, "halves", 0.0),
        ({"halves_apart_m": 0.03, "halves_apart_deg": 0.0}, None, "halves", math.log(10)),
        ({"halves_apart_m": 0.018, "halves_apart_deg": 0.8}, None, "halves", math.log(10)),  # both together
        ({"halves_apart_m": 1.0, "halves_apart_deg": 90.0}, None, "halves", -1.0),  # further says nothing more
        ({"halves_apart_m": 0.0, "halves_apart_deg": 0.0}, None, "halves", 7.0),
        # And so is a sharper loss.
        ({}, 10.0, "sharpness", 0.0),
        ({}, 0.1, "sharpness", math.log(100)),
        ({}, 90.0, "sharpness", -1.0),
        ({}, 0.0, "sharpness", 9.0),
    ],
)
def test_what_was_measured_is_a_sign(
    measures: dict[str, float], formal_deg: float | None, feature: str, sign: float
) -> None:
    formal = None if formal_deg is None else (0.01, formal_deg)
    assert features_of(judged(**measures), 0.9, formal, CONFIG)[feature] == pytest.approx(sign)


def test_the_probability_is_the_logistic_function_of_the_weighted_signs() -> None:
    flat = RadiusModel(0.0, 0.0, 0.0, 0.0)
    model = ConfidenceModel(0.5, {name: 0.1 * (k + 1) for k, name in enumerate(FEATURES)}, 0.5, flat, flat)
    features = {name: 1.0 - 0.2 * k for k, name in enumerate(FEATURES)}
    logit = 0.5 + sum(0.1 * (k + 1) * (1.0 - 0.2 * k) for k in range(len(FEATURES)))
    assert model.probability(features) == pytest.approx(1 / (1 + math.exp(-logit)))


def test_a_radius_is_a_product_of_powers() -> None:
    model = RadiusModel(log_factor=0.3, formal_power=0.5, halves_power=0.25, coverage_power=2.0)
    assert model.radius(0.04, 0.16, 0.1) == pytest.approx(math.exp(0.3) * 0.2 * 0.16**0.25 * 100)
    assert model.radius(0.0, 1e-9, 1.0) == pytest.approx(math.exp(0.3) * 1e-9**0.75)


def test_halves_are_never_nearer_than_the_curvature_allows_and_usual_where_nobody_asked() -> None:
    model = RadiusModel(log_factor=0.0, formal_power=0.0, halves_power=1.0, coverage_power=0.0)
    assert model.radius(0.04, 0.001, 1.0) == pytest.approx(0.04)
    assert model.radius(0.04, None, 1.0) == pytest.approx(0.28)


def test_error_radii_use_the_model_of_their_own_and_no_turn_is_more_than_half_a_one() -> None:
    position, orientation = RadiusModel(0.0, 1.0, 0.0, 0.0), RadiusModel(math.log(2), 0.0, 1.0, 1.0)
    model = ConfidenceModel(0.0, {}, 0.5, position, orientation)
    measures = {"halves_apart_m": 1.0, "halves_apart_deg": 6.0, "coverage": 0.5}
    assert list(error_radii((0.03, 5.0), measures, model)) == pytest.approx([0.03, 24.0])
    assert error_radii((0.03, 500.0), measures, model)[1] == 180.0


def test_formal_radii_are_those_of_independent_residuals() -> None:
    curvature = torch.diag(torch.tensor([1.0, 4.0, 16.0, 25.0, 100.0, 400.0]))
    hypothesis = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), hessian=curvature, residual_scale=0.2)
    found = known(formal_radii(hypothesis))
    assert found[0] == pytest.approx(0.2 * math.sqrt(1 / 25 + 1 / 100 + 1 / 400), rel=1e-6)
    assert found[1] == pytest.approx(math.degrees(0.2 * math.sqrt(1 + 1 / 4 + 1 / 16)), rel=1e-6)


def test_nothing_is_surer_to_be_right_than_its_radius_allows() -> None:
    assert share_within(None, None) == 1.0
    assert share_within(0.3, 1.0) == pytest.approx(0.68)
    assert share_within(0.1, 10.0) == pytest.approx(0.68)
    assert share_within(0.15, None) == pytest.approx(1 - 0.32**4)
    assert share_within(1.2, 0.1) < 0.08
