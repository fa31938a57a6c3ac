"""The tables of an evaluation for people."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from lab.evaluation import HeldOut, Summary
    from lab.evaluation.summary import Quartiles


def accuracy_table(found: "Sequence[Summary]", limits: Sequence[tuple[float, float]]) -> Table:
    """Return the paper's table: errors, accuracies, answers and seconds by group and method."""
    table = _table("group", "method")
    for heading in ("n", "t-error m (quartiles)", "R-error deg (quartiles)"):
        table.add_column(heading, justify="right", no_wrap=True)
    for position_m, orientation_deg in limits:
        table.add_column(f"{position_m:g} m {orientation_deg:g}°", justify="right")
    for heading in ("answered", "ambiguous", "wrong", "s p50", "s p95", "failed"):
        table.add_column(heading, justify="right")
    for one in found:
        table.add_row(
            escape(one.group),
            escape(one.method),
            str(one.num_queries),
            _quartiles(one.position_error_m, 4),
            _quartiles(one.orientation_error_deg, 2),
            *(f"{share:.2f}" for share in one.accuracies),
            f"{one.answered:.2f}",
            f"{one.ambiguous:.2f}",
            f"{one.wrong_answers:.3f}",
            f"{one.seconds_median:.2f}",
            f"{one.seconds_p95:.2f}",
            str(one.failed),
        )
    return table


def calibration_table(found: "Sequence[Summary]") -> Table:
    """Return how honest confidence and radii are, and how panoramas of other maps were answered."""
    table = _table("group", "method")
    for heading in (
        "answers",
        "calibration error",
        "ROC area",
        "68 % radius holds: t",
        "R",
        "strangers",
        "of them localized",
    ):
        table.add_column(heading, justify="right")
    for one in found:
        table.add_row(
            escape(one.group),
            escape(one.method),
            str(one.calibration.num_answers),
            _number(one.calibration.calibration_error),
            _number(one.calibration.area_under_roc),
            _number(one.calibration.radius_holds_position, 2),
            _number(one.calibration.radius_holds_orientation, 2),
            str(one.strangers),
            str(one.strangers_localized),
        )
    return table


def change_table(found: "Sequence[Summary]") -> Table | None:
    """Return the average precision of the change maps, ours beside the paper's; None when none was measured."""
    measured = [one for one in found if one.change]
    if not measured:
        return None
    table = _table("group", "method")
    headings = {
        "changed_pixels": "pixels changed",
        "ap_2d": "2D map AP",
        "paper_ap_2d": "paper's",
        "changed_points": "points changed",
        "ap_3d": "3D map AP",
        "paper_ap_3d": "paper's",
    }
    for heading in headings.values():
        table.add_column(heading, justify="right")
    for one in measured:
        table.add_row(escape(one.group), escape(one.method), *(_number(one.change.get(name)) for name in headings))
    return table


def held_out_table(held_out: "HeldOut") -> Table:
    """Return how a fitted confidence held on rows that it was not fitted to."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    for label, value in (
        ("held out in turn", ", ".join(held_out.groups)),
        ("rows", f"{held_out.num_rows}, {held_out.num_right} of them right"),
        ("calibration error", _number(held_out.calibration_error)),
        ("ROC area", _number(held_out.area_under_roc)),
        ("threshold", f"{held_out.threshold:.2f}"),
        ("wrong answers there", _number(held_out.wrong_answers, 4)),
        ("right poses answered there", _number(held_out.answered_right)),
        (
            "68 % radius holds",
            f"t {_number(held_out.radius_holds_position, 2)}, R {_number(held_out.radius_holds_orientation, 2)}",
        ),
    ):
        table.add_row(label, escape(value))
    return table


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    return table


def _quartiles(values: "Quartiles | None", digits: int) -> str:
    if values is None:
        return "–"
    return f"{values.median:.{digits}f} ({values.lower:.{digits}f}–{values.upper:.{digits}f})"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
