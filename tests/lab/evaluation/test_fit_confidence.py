"""The fit finds the coefficients that made the data, and its held-out figures are of rows that it did not see."""

import math

import numpy as np
import pytest

from panoloc.core.decide.confidence import FEATURES, ConfidenceModel, RadiusModel
from panoloc.lab.evaluation.fit_confidence import (
    features_of_row,
    fit_confidence,
    fit_growing_logistic,
    fit_logistic,
    radius_models,
)
from panoloc.lab.evaluation.rows import Row, RowsError
from tests.lab.evaluation.made_rows import made_row, measures


def test_the_logistic_fit_recovers_the_coefficients_that_drew_the_labels() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal((1.0, -2.0), (0.5, 3.0), (40_000, 2))
    logit = 0.7 + features @ np.array([2.0, -0.5])
    right = rng.random(len(logit)) < 1 / (1 + np.exp(-logit))

    intercept, coefficients = fit_logistic(features, right, regularization=1e-3)

    assert intercept == pytest.approx(0.7, abs=0.15)
    assert coefficients == pytest.approx([2.0, -0.5], abs=0.1)


def test_at_the_optimum_the_gradient_of_the_penalised_likelihood_vanishes() -> None:
    rng = np.random.default_rng(1)
    features = rng.normal(3.0, 2.0, (300, 3))
    right = features[:, 0] + rng.normal(0, 2, 300) > 3

    intercept, coefficients = fit_logistic(features, right, regularization=5.0)

    def loss(change: np.ndarray) -> float:  # an independent route: finite differences of the loss written out
        w = coefficients + change[1:]
        logit = intercept + change[0] + features @ w
        likelihood = np.where(right, -np.logaddexp(0, -logit), -np.logaddexp(0, logit)).sum()
        return float(-likelihood + 2.5 * ((w * features.std(0)) ** 2).sum())

    step = 1e-5
    gradient = [(loss(step * axis) - loss(-step * axis)) / (2 * step) for axis in np.eye(4)]
    assert gradient == pytest.approx(np.zeros(4), abs=1e-4)


def _rows(group: str, count: int, seed: int) -> list[Row]:
    """Return rows whose measures tell right from wrong, a third of them of other maps."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(count):
        good, cross = rng.random() < 0.5, number % 3 == 0
        value = float(np.clip(rng.normal(0.8 if good and not cross else 0.2, 0.12), 0.01, 1))
        rows.append(
            made_row(
                number,
                position_m=None if cross else (0.02 if good else 3.0) * rng.uniform(0.5, 1.5),
                group=group,
                scan=f"{group}-{number}",
                cross=cross,
                search={"measures": measures(value), "score": value, "runner_up_score": 0.1},
                formal_position_m=0.01,
                formal_orientation_deg=0.05,
            )
        )
    return rows


def test_the_document_is_what_the_confidence_model_reads() -> None:
    fitted = fit_confidence(_rows("rooms", 120, 0) + _rows("flats", 120, 1))
    document = fitted.document
    assert set(document["coefficients"]) == set(FEATURES)
    radii = (RadiusModel(**document[name]) for name in ("position_radius", "orientation_radius"))
    model = ConfidenceModel(*(document[name] for name in ("intercept", "coefficients", "threshold")), *radii)

    def probability(value: float) -> float:
        row = made_row(search={"measures": measures(value), "score": value, "runner_up_score": 0.1})
        return model.probability(dict(zip(FEATURES, features_of_row(row), strict=True)))

    assert probability(0.8) > 0.9
    assert probability(0.2) < 0.1


def test_groups_are_held_out_and_separable_ones_are_told_apart() -> None:
    held_out = fit_confidence(_rows("rooms", 120, 0) + _rows("flats", 120, 1)).held_out
    assert held_out.groups == ("flats", "rooms")
    assert held_out.area_under_roc is not None
    assert held_out.area_under_roc > 0.98
    assert held_out.wrong_answers <= 0.005
    assert held_out.answered_right is not None
    assert held_out.answered_right > 0.9
    # A group whose measures mislead is not saved by having been fitted.
    odd = [
        made_row(n, (3.0, 0.01)[n % 2], group="odd", scan=f"odd-{n}", search=search)
        for n in range(60)
        for search in [{"measures": measures((0.8, 0.2)[n % 2]), "score": 0.5, "runner_up_score": 0.1}]
    ]
    misled = fit_confidence(_rows("rooms", 120, 0) + odd).held_out
    assert misled.area_under_roc is not None
    assert misled.area_under_roc < 0.8


def _drawn_rows(seed: int, **facts: int) -> list[Row]:
    """Return rows whose errors follow the curvature, the halves and the coverage, as often as not by a tenth more."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(300):
        formal, coverage = math.exp(rng.uniform(-7, -5)), float(rng.uniform(0.05, 0.9))
        halves = formal * math.exp(rng.uniform(0.5, 3.5))
        error = formal**0.5 * halves**0.25 / coverage**0.3 * math.exp(rng.normal(0, 0.1)) / 3
        found = measures(0.5) | {"halves_apart_m": halves, "halves_apart_deg": 1.0, "coverage": coverage}
        formals = {"formal_position_m": formal, "formal_orientation_deg": 0.1}
        rows.append(made_row(number, position_m=error, search={"measures": found}, facts=facts, **formals))
    return rows


def test_the_radius_follows_what_errors_follow() -> None:
    model, orientation = radius_models(_drawn_rows(0))
    assert model.formal_power == pytest.approx(0.5, abs=0.1)
    assert model.halves_power == pytest.approx(0.25, abs=0.1)
    assert model.coverage_power == pytest.approx(0.3, abs=0.1)
    assert orientation.formal_power == 0  # one formal radius says nothing of how errors follow it


def test_what_tracking_adds_to_several_images_is_no_matter_of_the_fit() -> None:
    alone = _drawn_rows(0, num_images=1)
    assert radius_models([*alone, *_drawn_rows(1, num_images=4)]) == radius_models(alone)
    assert radius_models(_drawn_rows(0, num_images=4))[0] == RadiusModel(0.0, 1.0, 0.0, 0.0)


def test_the_radius_ignores_wrong_poses_and_never_falls_with_the_formal_one() -> None:
    rows = [
        made_row(n, position_m=0.1 / (n + 1), formal_position_m=0.01 * (n + 1), formal_orientation_deg=0.1)
        for n in range(20)
    ]
    wrong = [made_row(99, position_m=5.0, formal_position_m=0.01, formal_orientation_deg=0.1)]
    assert radius_models(rows) == radius_models(rows + wrong)
    assert radius_models(rows)[0].formal_power == 0


@pytest.mark.parametrize(
    ("search", "said"), [({}, "measures"), ({"measures": measures(0.5), "score": 1.0}, "all 4 are right")]
)
def test_rows_that_say_nothing_cannot_be_fitted(search: dict[str, object], said: str) -> None:
    with pytest.raises(RowsError, match=said):
        fit_confidence([made_row(n, search=search) for n in range(4)])


def test_a_sign_of_agreement_never_counts_against_an_answer() -> None:
    rng = np.random.default_rng(3)
    strength = rng.normal(size=400)
    features = np.column_stack((strength + 0.1 * rng.normal(size=400), -strength + rng.normal(size=400)))
    _, coefficients = fit_growing_logistic(features, strength > 0, regularization=1.0)
    assert coefficients[0] > 0
    assert coefficients[1] == 0


def test_rows_that_cannot_be_fitted_are_counted_by_why() -> None:
    rows = [*_rows("a", 60, 1), *_rows("b", 60, 2)]
    useless = [
        made_row(1000, None, status="error", error="DeadlineExceededError: late"),
        made_row(1001, None, status="not_localized"),
        made_row(1002, search={"score": 0.5}),
    ]
    fitted = fit_confidence([*rows, *useless, rows[0]])
    assert fitted.left_out == {
        "ended in an error": 1,
        "no pose was left to judge": 1,
        "the method measures nothing": 1,
        "made again later": 1,
    }
    assert fitted.document["fitted_on"]["rows"] == 120
    assert fit_confidence(rows).left_out == {}
