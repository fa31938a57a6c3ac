"""The tables of an evaluation for people."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.table import Table

from panoloc.lab.display import table

if TYPE_CHECKING:
    from panoloc.lab.evaluation.fit_confidence import HeldOut
    from panoloc.lab.evaluation.summary import Quartiles, Summary


def evaluation_tables(found: "Sequence[Summary]", limits: Sequence[tuple[float, float]]) -> list[Table]:
    """Return the tables: accuracy, calibration, and change maps where any were measured; none without a summary."""
    if not found:
        return []
    changed = [one for one in found if one.change]
    return [
        table([_accuracy(one, limits) for one in found], 2),
        table([_calibration(one) for one in found], 2),
        *([table([_change(one) for one in changed], 2)] if changed else []),
    ]


def _accuracy(one: "Summary", limits: Sequence[tuple[float, float]]) -> dict[str, object]:
    """Return a row of the paper's table: errors, accuracies, answers and seconds."""
    return {
        "group": one.group,
        "method": one.method,
        "n": one.num_queries,
        "t-error m (quartiles)": _quartiles(one.position_error_m, 4),
        "R-error deg (quartiles)": _quartiles(one.orientation_error_deg, 2),
        **{f"{m:g} m {deg:g}°": f"{share:.2f}" for (m, deg), share in zip(limits, one.accuracies, strict=True)},
        "answered": f"{one.answered:.2f}",
        "ambiguous": f"{one.ambiguous:.2f}",
        "wrong": f"{one.wrong_answers:.3f}",
        "s p50": f"{one.seconds_median:.2f}",
        "s p95": f"{one.seconds_p95:.2f}",
        "failed": one.failed,
    }


def _calibration(one: "Summary") -> dict[str, object]:
    """Return how honest confidence and radii are, and how panoramas of other maps were answered."""
    return {
        "group": one.group,
        "method": one.method,
        "answers": one.calibration.num_answers,
        "calibration error": _number(one.calibration.calibration_error),
        "ROC area": _number(one.calibration.area_under_roc),
        "68 % radius holds: t": _number(one.calibration.radius_holds_position, 2),
        "R": _number(one.calibration.radius_holds_orientation, 2),
        "strangers": one.strangers,
        "of them localized": one.strangers_localized,
    }


def _change(one: "Summary") -> dict[str, object]:
    """Return the average precision of the change maps beside the share that changed."""
    headings = {
        "changed_pixels": "pixels changed",
        "ap_2d": "2D map AP",
        "changed_points": "points changed",
        "ap_3d": "3D map AP",
    }
    figures = {heading: _number(one.change.get(name)) for name, heading in headings.items()}
    return {"group": one.group, "method": one.method, **figures}


def held_out_table(held_out: "HeldOut") -> Table:
    """Return how a fitted confidence held on rows that it was not fitted to."""
    radii = _number(held_out.radius_holds_position, 2), _number(held_out.radius_holds_orientation, 2)
    figures = {
        "rows": f"{held_out.num_rows}, {held_out.num_right} of them right",
        "calibration error": _number(held_out.calibration_error),
        "ROC area": _number(held_out.area_under_roc),
        "threshold": f"{held_out.threshold:.2f}",
        "wrong answers there": _number(held_out.wrong_answers, 4),
        "right poses answered there": _number(held_out.answered_right),
        "68 % radius holds": f"t {radii[0]}, R {radii[1]}",
    }
    rows = [{"held out in turn": name, ", ".join(held_out.groups): value} for name, value in figures.items()]
    return table(rows, 2)


def _quartiles(values: "Quartiles | None", digits: int) -> str:
    if values is None:
        return "–"
    return f"{values.median:.{digits}f} ({values.lower:.{digits}f}–{values.upper:.{digits}f})"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
