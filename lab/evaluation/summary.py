"""The paper's tables: rows of one group and method condensed to errors, accuracies, answers and seconds; and the report."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from panoloc.lab.evaluation.methods import ComparedMethod
from panoloc.lab.evaluation.metrics import (
    Flags,
    Floats,
    area_under_roc,
    expected_calibration_error,
    reliability_bins,
    share_within,
)
from panoloc.lab.evaluation.rows import RIGHT, TIGHT, Row
from panoloc.lab.machine import machine, versions

Limits = tuple[float, float]
DEFAULT_LIMITS: tuple[Limits, ...] = (TIGHT, RIGHT, (0.1, 1.0), (0.01, 1.0))
ALL_GROUPS = "all"


@dataclass(frozen=True)
class Quartiles:
    """First quartile, median and third quartile."""

    lower: float
    median: float
    upper: float


@dataclass(frozen=True)
class CalibrationSummary:
    """How honest the confidence is: `right` is within 0.3 m and 10 degrees, panoramas of other maps are never right.

    radius_*: the share of right poses whose error is within the 68 % radius that the answer states.
    """

    num_answers: int
    calibration_error: float | None
    area_under_roc: float | None
    radius_holds_position: float | None
    radius_holds_orientation: float | None


@dataclass(frozen=True)
class Summary:
    """One line of the tables.

    accuracies: share of queries within each of the limits (metres, degrees), in their order. answered: called localized; ambiguous:
    several places fit. wrong_answers: called localized though off by more than 0.5 m or 15 degrees. Errors in metres and degrees over
    the answers that have a pose, localized or not; seconds of the whole answer. strangers: panoramas of other maps, and how many of
    them were called localized. change: mean metrics of the change maps over the cases that have them. failed: calls that ended in an error.
    """

    group: str
    method: str
    num_queries: int
    position_error_m: Quartiles | None
    orientation_error_deg: Quartiles | None
    accuracies: tuple[float, ...]
    answered: float
    ambiguous: float
    wrong_answers: float
    seconds_median: float
    seconds_p95: float
    strangers: int
    strangers_localized: int
    failed: int
    calibration: CalibrationSummary
    change: dict[str, float]


def summaries(rows: Sequence[Row], limits: Sequence[Limits] = DEFAULT_LIMITS) -> list[Summary]:
    """Return one summary per group and method in the order of the rows, then one per method over all groups when there are several."""
    groups = list(dict.fromkeys(row.group for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    parts = [(group, [row for row in rows if row.group == group]) for group in groups]
    if len(groups) > 1:
        parts.append((ALL_GROUPS, list(rows)))
    return [
        summary
        for group, part in parts
        for method in methods
        if (summary := _summary(group, method, [row for row in part if row.method == method], limits)) is not None
    ]


def _summary(group: str, method: str, rows: Sequence[Row], limits: Sequence[Limits]) -> Summary | None:
    """Return the summary of the rows of one method; None when all of them are panoramas of other maps, or there are none."""
    own = [row for row in rows if not row.cross]
    strangers = [row for row in rows if row.cross]
    if not own:
        return None
    seconds = sorted(row.seconds for row in own)
    return Summary(
        group=group,
        method=method,
        num_queries=len(own),
        position_error_m=_quartiles([row.position_error_m for row in own]),
        orientation_error_deg=_quartiles([row.orientation_error_deg for row in own]),
        accuracies=tuple(_share([row.within(limit) for row in own]) for limit in limits),
        answered=_share([row.status == "localized" for row in own]),
        ambiguous=_share([row.status == "ambiguous" for row in own]),
        wrong_answers=_share([row.is_wrong_answer for row in own]),
        seconds_median=float(np.median(seconds)),
        # The nearest rank: a 95th percentile that was measured.
        seconds_p95=seconds[max(0, -(-95 * len(seconds) // 100) - 1)],
        strangers=len(strangers),
        strangers_localized=sum(row.status == "localized" for row in strangers),
        failed=sum(row.error is not None for row in rows),
        calibration=calibration_of(rows),
        change=_mean_change(own),
    )


def calibration_of(rows: Sequence[Row]) -> CalibrationSummary:
    """Return how the confidences of rows, those of other maps included, agree with what was right."""
    answers = [row for row in rows if row.confidence is not None]
    confidences, right = _confidences(rows)
    good = [row for row in answers if row.within(RIGHT)]
    return CalibrationSummary(
        len(answers),
        expected_calibration_error(confidences, right),
        area_under_roc(confidences, right),
        share_within([(row.position_error_m, row.accuracy_position_m) for row in good]),
        share_within([(row.orientation_error_deg, row.accuracy_orientation_deg) for row in good]),
    )


def _quartiles(values: Sequence[float | None]) -> Quartiles | None:
    known = [value for value in values if value is not None]
    return Quartiles(*(float(q) for q in np.quantile(known, (0.25, 0.5, 0.75)))) if known else None


def _share(flags: Sequence[bool]) -> float:
    return sum(flags) / len(flags)


def _mean_change(rows: Sequence[Row]) -> dict[str, float]:
    names = dict.fromkeys(name for row in rows for name in row.change)
    return {name: float(np.mean([row.change[name] for row in rows if name in row.change])) for name in names}


def report_document(
    found: Sequence[Summary],
    rows: Sequence[Row],
    methods: Sequence[ComparedMethod],
    limits: Sequence[Limits],
    command: Sequence[str],
) -> dict[str, Any]:
    """Return the tables, the reliability of the confidence by method, configurations with digests, machine, versions and command."""
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": list(command),
        "machine": machine(),
        "versions": versions(),
        "methods": {
            method.name: {"method": method.method, "digest": method.digest, "configuration": asdict(method.config)}
            for method in methods
        },
        "limits": [{"position_m": position, "orientation_deg": orientation} for position, orientation in limits],
        "summaries": [asdict(summary) for summary in found],
        "reliability": {method.name: _reliability(rows, method.name) for method in methods},
        "num_rows": len(rows),
    }


def _reliability(rows: Sequence[Row], method: str) -> list[dict[str, Any]]:
    bins = reliability_bins(*_confidences([row for row in rows if row.method == method]))
    return [asdict(one) for one in bins]


def _confidences(rows: Sequence[Row]) -> tuple[Floats, Flags]:
    """Return the confidences of those that have one, and which of these are right."""
    answers = [row for row in rows if row.confidence is not None]
    confidences = np.array([row.confidence for row in answers], np.float64)
    return confidences, np.array([row.within(RIGHT) for row in answers], bool)
