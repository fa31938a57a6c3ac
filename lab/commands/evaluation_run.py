"""What `panoloc evaluate` does once its options are known; imports the algorithm."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path

import torch
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from core.errors import OptionsError
from lab.commands.evaluation_tables import accuracy_table, calibration_table, change_table
from lab.evaluation import (
    Evaluation,
    Row,
    RowsFile,
    RunOptions,
    ScanCases,
    as_photos,
    compared_method,
    dataset_scans,
    folder_scans,
    limited,
    seed_range,
    suite_scans,
)
from lab.evaluation.plots import write_plots
from lab.evaluation.report import report_document
from lab.evaluation.summary import DEFAULT_LIMITS, Limits, summaries
from service.cli.session import Session

THREADS_VARIABLE = "PANOLOC_EVAL_THREADS"
ROWS_FILE, REPORT_JSON, REPORT_TEXT = "rows.jsonl", "report.json", "report.txt"
_TEXT_WIDTH = 240


@dataclass(frozen=True)
class EvaluationRequest:
    """The options of the command; lab/commands/evaluation_options.py says what each means."""

    suites: tuple[str, ...]
    seeds: str
    families: tuple[str, ...]
    cameras: tuple[str, ...]
    width: int
    num_points: int | None
    cases: tuple[Path, ...]
    tags: tuple[str, ...]
    dataset: str | None
    root: Path | None
    splits: tuple[str, ...]
    limit: int | None
    methods: tuple[str, ...]
    device: str | None
    timeout_s: float | None
    spacing_m: float | None
    num_strangers: int
    change_maps: bool
    out: Path
    limits: tuple[str, ...]


def run_evaluation(request: EvaluationRequest, session: Session) -> None:
    """Run what is left of an evaluation, print its tables, and write report and plots beside the rows.

    Raises a CoreError for options and sources that are not as expected.
    """
    torch.set_num_threads(num_threads(os.environ.get(THREADS_VARIABLE)))
    limits = tuple(map(parse_limits, request.limits)) or DEFAULT_LIMITS
    methods = [compared_method(text) for text in request.methods]
    options = RunOptions(request.device, request.num_strangers, request.change_maps, request.timeout_s)
    evaluation = Evaluation(scans_of(request), methods, RowsFile(request.out / ROWS_FILE), options)
    rows = _run(evaluation, session)
    found = summaries(rows, limits)
    document = report_document(found, rows, methods, limits, ["panoloc", *sys.argv[1:]])
    tables = [accuracy_table(found, limits), calibration_table(found), change_table(found)]
    request.out.mkdir(parents=True, exist_ok=True)
    (request.out / REPORT_JSON).write_text(dumps(document, indent=1) + "\n", encoding="utf-8")
    with (request.out / REPORT_TEXT).open("w", encoding="utf-8") as stream:
        _print_tables(Console(file=stream, width=_TEXT_WIDTH), tables)
    if session.json_output:
        session.print_json(document)
    else:
        _print_tables(session.results, tables)
    written = [REPORT_TEXT, REPORT_JSON, ROWS_FILE]
    plots = write_plots(rows, request.out)
    if plots is None:
        session.messages.print("No plots: matplotlib is not installed (pip install 'panoloc\\[plots]').")
    else:
        written += [path.name for path in plots]
    session.messages.print(f"In {escape(str(request.out))}: {', '.join(written)}")


def scans_of(request: EvaluationRequest) -> list[ScanCases]:
    """Return the cases that the options name; raises OptionsError when they name none."""
    groups: list[Sequence[ScanCases]] = []
    seeds = seed_range(request.seeds)
    for suite in _with_cameras(request.suites, request.cameras):
        made = suite_scans(
            suite,
            seeds,
            families=request.families,
            width=request.width,
            num_points=request.num_points,
            spacing_m=request.spacing_m,
        )
        groups.append(made)
    of_panoramas = [folder_scans(folder, tags=request.tags) for folder in request.cases]
    if request.dataset is not None:
        if request.root is None:
            raise OptionsError("dataset: expected --root with the folder of the data set beside --dataset")
        of_panoramas += [dataset_scans(request.dataset, request.root, split) for split in request.splits or (None,)]
    for scans in of_panoramas:
        groups += [as_photos(scans, camera, seeds, request.width) for camera in request.cameras] or [scans]
    if not groups:
        raise OptionsError("cases: expected --suite, --cases or --dataset; `panoloc evaluate --help` lists them")
    return [scan for group in groups for scan in limited(group, request.limit)]


def _with_cameras(suites: Sequence[str], cameras: Sequence[str]) -> list[str]:
    """Return the names of suites with each of the cameras; those that name one already keep it."""
    return [
        name
        for suite in suites
        for name in ([suite] if "/" in suite or not cameras else [f"{suite}/{camera}" for camera in cameras])
    ]


def num_threads(text: str | None) -> int:
    """Return how many threads to compute with: `text`, or all processors; raises OptionsError for anything but a positive number."""
    if text is None:
        return os.cpu_count() or 1
    if not text.isdigit() or int(text) < 1:
        raise OptionsError(f"{THREADS_VARIABLE}: expected a positive number, got {text!r}")
    return int(text)


def parse_limits(text: str) -> Limits:
    """Return (metres, degrees) of a text such as `0.05,5`; raises OptionsError for anything else."""
    try:
        position_m, orientation_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise OptionsError(f"within: expected metres and degrees such as 0.05,5, got {text!r}") from None
    return position_m, orientation_deg


def _run(evaluation: Evaluation, session: Session) -> list[Row]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    rows, reused = [], 0
    console = session.messages
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("evaluating", total=evaluation.num_calls)
        for row, is_new in evaluation.rows(lambda text: bar.update(task, description=escape(text))):
            rows.append(row)
            reused += not is_new
            bar.advance(task)
            if row.error is not None:
                console.print(f"[bold red]{escape(row.query)}[/]: {escape(row.error)}")
    if reused:
        console.print(f"{reused} of {len(rows)} answers were in the file of rows already.")
    return rows


def _print_tables(console: Console, tables: Sequence[object]) -> None:
    for table in tables:
        if table is not None:
            console.print(table)
            console.print()
