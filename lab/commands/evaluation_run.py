"""What `panoloc evaluate` and its `campus` do once their options are known, and tables for people; imports the algorithm."""

import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from json import dumps
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from panoloc.core.errors import OptionsError
from panoloc.core.kernels.library import use_threads
from panoloc.core.localizer import Localizer
from panoloc.lab.display import print_tables, progress, show_report, table
from panoloc.lab.evaluation.campus import Campus, campus_queries, campus_rows, campus_summary, read_vectors
from panoloc.lab.evaluation.fit_confidence import HeldOut
from panoloc.lab.evaluation.known_cases import ScanCases
from panoloc.lab.evaluation.methods import compared_method
from panoloc.lab.evaluation.rows import Row, RowsFile
from panoloc.lab.evaluation.runner import Evaluation, RunOptions
from panoloc.lab.evaluation.summary import DEFAULT_LIMITS, Limits, Quartiles, Summary, report_document, summaries
from panoloc.service.cli.session import Session

THREADS_VARIABLE = "PANOLOC_EVAL_THREADS"


def run_evaluation(
    scans: Sequence[ScanCases],
    method_names: Sequence[str],
    options: RunOptions,
    limit_texts: Sequence[str],
    out: Path,
    session: Session,
) -> None:
    """Run what is left of an evaluation, print its tables, and write the report beside the rows.

    Raises a CoreError for options and sources that are not as expected.
    """
    set_threads()
    limits = tuple(map(_parsed_limits, limit_texts)) or DEFAULT_LIMITS
    methods = [compared_method(text) for text in method_names]
    rows = rows_shown(Evaluation(scans, methods, RowsFile(out / "rows.jsonl"), options), session)
    found = summaries(rows, limits)
    document = report_document(found, rows, methods, limits, ["panoloc", *sys.argv[1:]])
    show_report(session, out, "report", document, evaluation_tables(found, limits))
    session.messages.print(f"In {escape(str(out))}: report.txt, report.json, rows.jsonl")


def run_campus(
    sizes: Sequence[int], num_queries: int, camera: str | None, device: str | None, out: Path, session: Session
) -> None:
    """Build what is missing of each campus, localize queries in it, and print and write the figures."""
    set_threads()
    localizer, figures = Localizer(device=device), []
    for num_maps in sizes:
        campus = Campus(out / "maps", num_maps)
        for number in range(num_maps):
            campus.build(number)
            if number % 50 == 0:
                session.messages.print(f"{num_maps} maps: {number} built")
        queries, vectors = list(campus_queries(campus, num_queries, camera)), read_vectors(campus)
        rows = list(campus_rows(campus, vectors, queries, localizer))
        figures.append(campus_summary(campus, vectors, rows))
        name = f"rows-{num_maps}-{camera or 'panorama'}.jsonl"
        (out / name).write_text("".join(dumps(asdict(row)) + "\n" for row in rows), encoding="utf-8")
    if session.json_output:
        session.print_json({"campus": figures})
    else:
        print_tables(session.results, [table(figures, 0)])
    session.messages.print(f"Rows of each query in {escape(str(out))}")


def set_threads() -> None:
    """Compute with as many threads as the environment says, all processors otherwise. Raises OptionsError for anything but a number."""
    use_threads(_num_threads(os.environ.get(THREADS_VARIABLE)))


def _num_threads(text: str | None) -> int:
    if text is None:
        return os.cpu_count() or 1
    if not text.isdigit() or int(text) < 1:
        raise OptionsError(f"{THREADS_VARIABLE}: expected a positive number, got {text!r}")
    return int(text)


def _parsed_limits(text: str) -> Limits:
    """Return (metres, degrees) of a text such as `0.05,5`."""
    try:
        position_m, orientation_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise OptionsError(f"within: expected metres and degrees such as 0.05,5, got {text!r}") from None
    return position_m, orientation_deg


def rows_shown(evaluation: Evaluation, session: Session) -> list[Row]:
    """Return all rows of an evaluation; show how far it is, and errors."""
    rows, reused = [], 0
    console = session.messages
    with progress(console, evaluation.num_calls) as (say, advance):
        for row, is_new in evaluation.rows(say):
            rows.append(row)
            reused += not is_new
            advance()
            if row.error is not None:
                console.print(f"[bold red]{escape(row.query)}[/]: {escape(row.error)}")
    if reused:
        console.print(f"{reused} of {len(rows)} answers were in the file of rows already.")
    return rows


def evaluation_tables(found: Sequence[Summary], limits: Sequence[Limits]) -> list[Table]:
    """Return the tables: accuracy, calibration, and change maps where any were measured; none without a summary."""
    if not found:
        return []
    changed = [one for one in found if one.change]
    return [
        table([_accuracy(one, limits) for one in found], 2),
        table([_calibration(one) for one in found], 2),
        *([table([_change(one) for one in changed], 2)] if changed else []),
    ]


def _accuracy(one: Summary, limits: Sequence[Limits]) -> dict[str, object]:
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


def _calibration(one: Summary) -> dict[str, object]:
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


def _change(one: Summary) -> dict[str, object]:
    """Return the average precision of the change maps beside the share that changed."""
    headings = {
        "changed_pixels": "pixels changed",
        "ap_2d": "2D map AP",
        "changed_points": "points changed",
        "ap_3d": "3D map AP",
    }
    figures = {heading: _number(one.change.get(name)) for name, heading in headings.items()}
    return {"group": one.group, "method": one.method, **figures}


def held_out_table(held_out: HeldOut) -> Table:
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


def _quartiles(values: Quartiles | None, digits: int) -> str:
    if values is None:
        return "–"
    return f"{values.median:.{digits}f} ({values.lower:.{digits}f}–{values.upper:.{digits}f})"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
