"""The fit finds the coefficients that made the data, and its held-out figures are of rows that it did not see."""

import math
from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.decide.confidence import FEATURES, ConfidenceModel, RadiusModel
from panoloc.lab.evaluation.fit_confidence import (
    features_of_row,
    fit_alias_power,
    fit_confidence,
    fit_growing_logistic,
    fit_logistic,
    radius_models,
)
from panoloc.lab.evaluation.rows import Row, RowsError
from tests.lab.evaluation.made_rows import made_row, searched


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
                search=searched(value),
                formal_position_m=0.01,
                formal_orientation_deg=0.05,
            )
        )
    return rows


def test_the_document_is_what_the_confidence_model_reads() -> None:
    fitted = fit_confidence(_rows("rooms", 120, 0) + _rows("flats", 120, 1))
    document = fitted.document
    assert set(document["coefficients"]) == set(FEATURES)
    position, orientation = (RadiusModel(**document[name]) for name in ("position_radius", "orientation_radius"))
    intercept, coefficients, power, threshold = (
        document[name] for name in ("intercept", "coefficients", "alias_power", "threshold")
    )
    model = ConfidenceModel(intercept, coefficients, power, threshold, position, orientation, 0.5)

    def probability(value: float) -> float:
        row = made_row(search=searched(value))
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
        made_row(n, (3.0, 0.01)[n % 2], group="odd", scan=f"odd-{n}", search=searched((0.8, 0.2)[n % 2]))
        for n in range(60)
    ]
    misled = fit_confidence(_rows("rooms", 120, 0) + odd).held_out
    assert misled.area_under_roc is not None
    assert misled.area_under_roc < 0.8


def _drawn_rows(seed: int, **facts: int) -> list[Row]:
    """Return rows whose errors follow the curvature, the halves, the coverage and the scan, as often as not by a tenth more."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(300):
        formal, coverage = math.exp(rng.uniform(-7, -5)), float(rng.uniform(0.05, 0.9))
        halves, thickness = formal * math.exp(rng.uniform(0.5, 3.5)), float(rng.uniform(0.004, 0.03))
        error = formal**0.5 * halves**0.25 / coverage**0.3 * thickness**0.4 * math.exp(rng.normal(0, 0.1))
        found = searched(0.5, halves_apart_m=halves, halves_apart_deg=1.0, coverage=coverage, thickness_m=thickness)
        formals = {"formal_position_m": formal, "formal_orientation_deg": 0.1}
        rows.append(made_row(number, position_m=error, search=found, facts=facts, **formals))
    return rows


def test_the_radius_follows_what_errors_follow() -> None:
    model, orientation = radius_models(_drawn_rows(0))
    assert model.formal_power == pytest.approx(0.5, abs=0.1)
    assert model.halves_power == pytest.approx(0.25, abs=0.1)
    assert model.coverage_power == pytest.approx(0.3, abs=0.1)
    assert model.thickness_power == pytest.approx(0.4, abs=0.1)
    assert orientation.formal_power == 0  # one formal radius says nothing of how errors follow it


def test_what_tracking_adds_to_several_images_is_no_matter_of_the_fit() -> None:
    alone = _drawn_rows(0, num_images=1)
    assert radius_models([*alone, *_drawn_rows(1, num_images=4)]) == radius_models(alone)
    assert radius_models(_drawn_rows(0, num_images=4))[0] == RadiusModel(0.0, 1.0, 0.0, 0.0, 0.0)


def test_the_radius_ignores_wrong_poses_and_never_falls_with_the_formal_one() -> None:
    rows = [
        made_row(n, position_m=0.1 / (n + 1), formal_position_m=0.01 * (n + 1), formal_orientation_deg=0.1)
        for n in range(20)
    ]
    wrong = [made_row(99, position_m=5.0, formal_position_m=0.01, formal_orientation_deg=0.1)]
    assert radius_models(rows) == radius_models(rows + wrong)
    assert radius_models(rows)[0].formal_power == 0


@pytest.mark.parametrize(("search", "said"), [({}, "measures"), (searched(0.5), "all 4 are right")])
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


@pytest.mark.parametrize(
    ("row", "far_off"),
    [
        (made_row(position_m=0.29), False),
        (made_row(position_m=0.4), False),
        (made_row(position_m=0.6), True),
        (made_row(orientation_deg=16.0), True),
        (made_row(position_m=None), True),
        (made_row(cross=True), True),
        # In one of rooms that are alike a pose is measured to where it would be in each.
        (made_row(facts={"place": "own"}), False),
        (made_row(facts={"place": "other"}), True),
    ],
)
def test_far_off_is_anywhere_but_near_the_truth_in_the_room_that_was_photographed(row: Row, far_off: bool) -> None:
    assert row.is_far_off == far_off


def test_ambiguous_answers_are_fitted_on_as_well() -> None:
    rows = [*_rows("a", 60, 1), *_rows("b", 60, 2)]
    ambiguous = [replace(row, status="ambiguous") for row in rows]
    assert fit_confidence(ambiguous) == fit_confidence(rows)


def test_the_power_that_divides_among_aliases_is_the_one_by_which_the_right_ones_were_drawn() -> None:
    rng = np.random.default_rng(4)
    rows = []
    for number in range(1000):
        margins = rng.uniform(-0.1, 0.5, 1 + number % 2)
        is_own = rng.random() < 1 / (1 + np.exp(-6.0 * margins).sum())
        search = searched(0.5) | {"alias_margins": margins.tolist()}
        rows.append(made_row(number, search=search, facts={"place": "own" if is_own else "other"}))
    power = fit_alias_power(rows)
    assert power == pytest.approx(6.0, abs=1.0)
    alone, together = (fit_confidence([*some, *_rows("a", 60, 1)]).document for some in ([], rows))
    assert (alone["alias_power"], together["alias_power"]) == (0.0, power)
    # Which of the aliases a pose is in is no matter of the other coefficients.
    assert together["fitted_on"]["right"] == alone["fitted_on"]["right"] + 1000
    # Neither rooms without aliases nor poses that are in none of the rooms that are alike say anything of it.
    silent = [
        replace(rows[0], facts={}),
        replace(rows[0], facts={"place": "elsewhere"}),
        made_row(facts={"place": "own"}),
    ]
    assert fit_alias_power([*rows, *silent]) == power
    assert fit_alias_power(silent) == 0.0


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
