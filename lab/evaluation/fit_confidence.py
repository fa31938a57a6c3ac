"""Fits the confidence on rows with known truth, and says how it holds on groups of rows that it was not fitted on."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.decide.confidence import FEATURES, RadiusModel, radius_signs
from panoloc.lab.evaluation.metrics import area_under_roc, expected_calibration_error, share_within
from panoloc.lab.evaluation.rows import RIGHT, Row, RowsError

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Radii = NDArray[np.object_]
"""Of rows, (N, 2), metres and degrees; None where unknown."""
_RADIUS_LEVEL = 0.68
# Percent; of the few answers between 0.6 and 0.7 nearly half are wrong, and a wrong pose is worse than none.
_LEAST_THRESHOLD = 75
_LEAST_ERROR = 1e-5  # metres or degrees: no pose is known better
_MOST_ALIAS_POWER = 20.0
_TELLING_SPREAD = 0.05  # of a sign, below which rows do not determine its power


@dataclass(frozen=True)
class HeldOut:
    """How probabilities held on the rows of groups that the fit had not seen.

    threshold: the smallest from 0.7 up at which wrong answers stay within what was allowed; the shares below hold at it. wrong_answers:
    of all rows, called localized though far off or of another map. answered_right: of the rows with a right pose, called localized.
    radius_holds_*: of right poses of single images.
    """

    groups: tuple[str, ...]
    num_rows: int
    num_right: int
    calibration_error: float | None
    area_under_roc: float | None
    threshold: float
    wrong_answers: float
    answered_right: float | None
    radius_holds_position: float | None
    radius_holds_orientation: float | None


@dataclass(frozen=True)
class ConfidenceFit:
    """The fit to all rows, as `panoloc.core.decide.confidence` reads it, and how it holds on held-out groups.

    left_out: how many rows the fit could not use, by why.
    """

    document: dict[str, Any]
    held_out: HeldOut
    left_out: dict[str, int]


def fit_confidence(rows: Sequence[Row], *, regularization: float = 1.0, max_wrong: float = 0.005) -> ConfidenceFit:
    """Fit a logistic regression of `right` (0.3 m, 10 degrees; never for another map) on
    `panoloc.core.decide.confidence.FEATURES`.

    regularization: L2, in rows, on standardised features. max_wrong: share of wrong answers allowed at the threshold. Every group is
    predicted by a fit to the other groups; a single group is split into five parts by panorama's scan.
    Raises RowsError when rows have no measures, or are all right or all wrong.
    """
    # Of the same call with two configurations, the later.
    latest = {(row.scan, row.query, row.method): row for row in rows}
    why = {key: _why_unusable(row) for key, row in latest.items()}
    usable = [row for key, row in latest.items() if why[key] is None]
    left_out = dict(Counter(reason for reason in why.values() if reason is not None))
    if len(rows) > len(latest):
        left_out["made again later"] = len(rows) - len(latest)
    if not usable:
        said = ", ".join(f"{number} {reason}" for reason, number in left_out.items()) or "no rows at all"
        raise RowsError(
            f"rows: expected rows whose search has measures and score, found none ({said}); run `panoloc evaluate` again"
        )
    features = np.array([features_of_row(row) for row in usable])
    right = np.array([row.within(RIGHT) for row in usable])  # in any of several equal rooms
    if right.all() or not right.any():
        which = "right" if right.all() else "wrong"
        raise RowsError(
            f"rows: expected right and wrong poses, all {len(usable)} are {which}; add harder or easier cases"
        )
    names = _fold_names(usable)
    # A pose in another of rooms that are alike fits as well as a right one, and says nothing of how right ones look.
    taught = np.array([row.facts.get("place") != "other" for row in usable])
    alias_power = fit_alias_power(usable)
    predicted, radii = _predict_held_out(usable, features, right, taught, names, regularization)
    predicted *= [_alias_share(row, alias_power) for row in usable]
    threshold = _threshold(predicted, usable, max_wrong)
    held_out = _held_out(usable, right, predicted, radii, threshold, names)
    intercept, coefficients = fit_growing_logistic(features[taught], right[taught], regularization)
    position, orientation = radius_models(usable)
    document = {
        "intercept": intercept,
        "coefficients": dict(zip(FEATURES, coefficients.tolist(), strict=True)),
        "alias_power": alias_power,
        "threshold": threshold,
        "position_radius": asdict(position),
        "orientation_radius": asdict(orientation),
        "fitted_on": {"groups": sorted({row.group for row in usable}), "rows": len(usable), "right": int(right.sum())},
    }
    return ConfidenceFit(document, held_out, left_out)


def _why_unusable(row: Row) -> str | None:
    """Return why nothing can be fitted to a row, None where it can."""
    if row.error is not None:
        return "ended in an error"
    if row.search.get("score") is None:
        return "no pose was left to judge"
    return None if row.search.get("features") else "the method measures nothing"


def features_of_row(row: Row) -> list[float]:
    """Return the features of a row in the order of `FEATURES`."""
    values = row.search["features"]
    return [float(values[name]) for name in FEATURES]


def fit_alias_power(rows: Sequence[Row]) -> float:
    """Return the power of scores with which places that look the same are told apart, by the likelihood of those that were right.

    Of rows of rooms that are alike, with a pose in one of them; the mildest power, 0, without any.
    """
    told = [
        (row, row.facts["place"] == "own")
        for row in rows
        if row.search.get("alias_margins") and row.facts.get("place") in ("own", "other")
    ]
    powers = np.linspace(0.0, _MOST_ALIAS_POWER, 101)

    def likelihood(power: float) -> float:
        """Return the logarithm of the likelihood."""
        shares = [(_alias_share(row, power), is_own) for row, is_own in told]
        return float(sum(np.log(share if is_own else 1 - share) for share, is_own in shares))

    return float(max(powers, key=likelihood)) if told else 0.0


def _alias_share(row: Row, power: float) -> float:
    """Return how probably a pose is the one of its aliases that was photographed."""
    margins = np.asarray(row.search.get("alias_margins") or (), np.float64)
    return float(1 / (1 + np.exp(-power * margins).sum()))


def fit_growing_logistic(features: Floats, right: Flags, regularization: float) -> tuple[float, Floats]:
    """Return intercept and coefficients (F,) as `fit_logistic` does, none of them negative.

    Every feature is a sign of agreement; a negative weight would let an answer that agrees better be trusted less, which only a
    coincidence of the fitted rows can ask for. Features with a negative weight are left out, the worst first.
    """
    kept = np.arange(features.shape[1])
    while True:
        intercept, coefficients = fit_logistic(features[:, kept], right, regularization)
        if len(kept) == 0 or coefficients.min() >= 0:
            break
        kept = np.delete(kept, int((coefficients * features[:, kept].std(0)).argmin()))
    full = np.zeros(features.shape[1])
    full[kept] = coefficients
    return intercept, full


def fit_logistic(features: Floats, right: Flags, regularization: float, iterations: int = 100) -> tuple[float, Floats]:
    """Return intercept and coefficients (F,) of features (N, F) as given, by Newton steps on the penalised likelihood.

    Features are standardised for the penalty `½ regularization ‖w‖²`, which leaves the intercept free.
    """
    mean, deviation = features.mean(0), np.maximum(features.std(0), 1e-9)
    design = np.column_stack((np.ones(len(features)), (features - mean) / deviation))
    penalty = np.diag([1e-9, *[regularization] * features.shape[1]])
    weights = np.zeros(design.shape[1])
    for _ in range(iterations):
        probability = _sigmoid(design @ weights)
        gradient = design.T @ (probability - right) + penalty @ weights
        curvature = (design * (probability * (1 - probability))[:, None]).T @ design + penalty
        step = np.linalg.solve(curvature, gradient)
        # Far from the optimum a full step overshoots.
        weights -= step * min(1.0, 5.0 / max(float(np.abs(step).max()), 1e-12))
        if np.abs(step).max() < 1e-9:
            break
    coefficients = weights[1:] / deviation
    return float(weights[0] - coefficients @ mean), coefficients


def radius_models(rows: Sequence[Row]) -> tuple[RadiusModel, RadiusModel]:
    """Return the radii of position and orientation that hold 68 % of the right poses of single images; the formal radii without any.

    What tracking adds to several images is no matter of this fit (`JudgeConfig.tracking_radii`).
    """
    return _radius_model(rows, 0), _radius_model(rows, 1)


def _radius_model(rows: Sequence[Row], axis: int) -> RadiusModel:
    """Fit the powers to the logarithm of errors, then shift them to hold 68 %. axis: 0 of the position, 1 of the orientation.

    A power that would be negative, or that the rows do not determine, is left out.
    """
    right = [row for row in rows if row.within(RIGHT) and _formal_of(row)[axis] and _is_of_one_image(row)]
    if not right:
        return RadiusModel(0.0, 1.0, 0.0, 0.0, 0.0)
    known = np.array([(row.position_error_m, row.orientation_error_deg)[axis] for row in right], np.float64)
    errors = np.log(np.maximum(known, _LEAST_ERROR))
    signs = np.array([radius_signs(*_radius_arguments(row, axis)) for row in right])
    kept = [column for column in range(4) if signs[:, column].std() > _TELLING_SPREAD]
    powers = np.zeros(4)
    while kept:
        centered = signs[:, kept] - signs[:, kept].mean(0)
        # A penalty of one row keeps few rows from asking for wild powers.
        solved = np.linalg.solve(centered.T @ centered + np.eye(len(kept)), centered.T @ (errors - errors.mean()))
        if solved.min() >= 0:
            powers[kept] = solved
            break
        kept.remove(kept[int(solved.argmin())])
    shift = float(np.quantile(errors - signs @ powers, _RADIUS_LEVEL))
    return RadiusModel(shift, *powers.tolist())


def _formal_of(row: Row) -> tuple[float | None, float | None]:
    return row.formal_position_m, row.formal_orientation_deg


def _radius_arguments(row: Row, axis: int) -> tuple[float, float, float, float]:
    """Return what the radius of a row is worked out from."""
    measures, formal = row.search.get("measures") or {}, _formal_of(row)[axis]
    assert formal is not None
    return (
        formal,
        measures.get(("halves_apart_m", "halves_apart_deg")[axis], 0.0),
        measures.get("coverage", 1.0),
        measures.get("thickness_m", 0.0),
    )


def _is_of_one_image(row: Row) -> bool:
    return bool(row.facts.get("num_images", 1) == 1)


def _fold_names(rows: Sequence[Row]) -> list[str]:
    """Return for each row the part that it is held out with: its group, or one of five parts of a single group."""
    groups = [row.group for row in rows]
    if len(set(groups)) > 1:
        return groups
    owners = [row.query.rpartition("/")[0] for row in rows]
    number = {owner: k for k, owner in enumerate(sorted(set(owners)))}
    return [f"{row.group}, part {number[owner] % 5 + 1}" for row, owner in zip(rows, owners, strict=True)]


def _predict_held_out(
    rows: Sequence[Row], features: Floats, right: Flags, taught: Flags, names: Sequence[str], regularization: float
) -> tuple[Floats, Radii]:
    """Return probabilities (N,) and radii, each from a fit to the other groups."""
    predicted, radii = np.full(len(rows), right.mean()), np.full((len(rows), 2), None)
    for name in sorted(set(names)):
        out = np.array([one == name for one in names])
        rest = ~out & taught
        if right[rest].any() and not right[rest].all():
            intercept, coefficients = fit_growing_logistic(features[rest], right[rest], regularization)
            predicted[out] = _sigmoid(intercept + features[out] @ coefficients)
        models = radius_models([row for row, kept in zip(rows, rest, strict=True) if kept])
        for number in out.nonzero()[0].tolist():
            row = rows[number]
            for axis, formal in enumerate(_formal_of(row)):
                if formal is not None and _is_of_one_image(row):
                    radii[number, axis] = models[axis].radius(*_radius_arguments(row, axis))
    return predicted, radii


def _threshold(predicted: Floats, rows: Sequence[Row], max_wrong: float) -> float:
    far_off = np.array([row.is_far_off for row in rows])
    for step in range(_LEAST_THRESHOLD, 100):
        if float(np.mean((predicted >= step / 100) & far_off)) <= max_wrong:
            return step / 100
    return 0.99


def _held_out(
    rows: Sequence[Row], right: Flags, predicted: Floats, radii: Radii, threshold: float, names: Sequence[str]
) -> HeldOut:
    called = predicted >= threshold
    far_off = np.array([row.is_far_off for row in rows])
    held = [(row, limits) for row, good, limits in zip(rows, right, radii, strict=True) if good]
    return HeldOut(
        groups=tuple(sorted(set(names))),
        num_rows=len(rows),
        num_right=int(right.sum()),
        calibration_error=expected_calibration_error(predicted, right),
        area_under_roc=area_under_roc(predicted, right),
        threshold=threshold,
        wrong_answers=float(np.mean(called & far_off)),
        answered_right=float(np.mean(called[right])) if right.any() else None,
        radius_holds_position=share_within((row.position_error_m, limits[0]) for row, limits in held),
        radius_holds_orientation=share_within((row.orientation_error_deg, limits[1]) for row, limits in held),
    )


def _sigmoid(logit: Floats) -> Floats:
    return np.asarray(1 / (1 + np.exp(-np.clip(logit, -50, 50))))
