"""What `panoloc evaluate` does once its options are known; imports the algorithm."""

import os
import sys
from collections.abc import Sequence
from json import dumps
from pathlib import Path

import torch
from rich.console import Console
from rich.markup import escape

from panoloc.core.errors import OptionsError
from panoloc.lab.commands.evaluation_tables import evaluation_tables
from panoloc.lab.display import print_tables, progress
from panoloc.lab.evaluation.datasets import dataset_scans
from panoloc.lab.evaluation.known_cases import ScanCases, limited
from panoloc.lab.evaluation.methods import compared_method
from panoloc.lab.evaluation.photo_source import as_photos
from panoloc.lab.evaluation.rows import Row, RowsFile
from panoloc.lab.evaluation.runner import Evaluation, RunOptions
from panoloc.lab.evaluation.sources import folder_scans, seed_range, suite_scans
from panoloc.lab.evaluation.summary import DEFAULT_LIMITS, Limits, report_document, summaries
from panoloc.service.cli.session import Session

THREADS_VARIABLE = "PANOLOC_EVAL_THREADS"
_TEXT_WIDTH = 240


def scans_of(
    *,
    suites: Sequence[str],
    seeds: str,
    families: Sequence[str],
    cameras: Sequence[str],
    width: int,
    num_points: int | None,
    spacing_m: float | None,
    cases: Sequence[Path],
    tags: Sequence[str],
    dataset: str | None,
    root: Path | None,
    splits: Sequence[str],
    limit: int | None,
) -> list[ScanCases]:
    """Return the cases that the options of the command name; raises OptionsError when they name none."""
    groups: list[Sequence[ScanCases]] = []
    numbers = seed_range(seeds)
    for name in suites:
        # A suite that names a camera keeps it.
        for suite in [name] if "/" in name or not cameras else [f"{name}/{camera}" for camera in cameras]:
            groups.append(
                suite_scans(suite, numbers, families=families, width=width, num_points=num_points, spacing_m=spacing_m)
            )
    of_panoramas = [folder_scans(folder, tags=tuple(tags)) for folder in cases]
    if dataset is not None:
        if root is None:
            raise OptionsError("dataset: expected --root with the folder of the data set beside --dataset")
        of_panoramas += [dataset_scans(dataset, root, split) for split in splits or (None,)]
    for scans in of_panoramas:
        groups += [as_photos(scans, camera, numbers, width) for camera in cameras] or [scans]
    if not groups:
        raise OptionsError("cases: expected --suite, --cases or --dataset; `panoloc evaluate --help` lists them")
    return [scan for group in groups for scan in limited(group, limit)]


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
    torch.set_num_threads(_num_threads(os.environ.get(THREADS_VARIABLE)))
    limits = tuple(map(_parsed_limits, limit_texts)) or DEFAULT_LIMITS
    methods = [compared_method(text) for text in method_names]
    rows = _run(Evaluation(scans, methods, RowsFile(out / "rows.jsonl"), options), session)
    found = summaries(rows, limits)
    document = report_document(found, rows, methods, limits, ["panoloc", *sys.argv[1:]])
    tables = evaluation_tables(found, limits)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").write_text(dumps(document, indent=1) + "\n", encoding="utf-8")
    with (out / "report.txt").open("w", encoding="utf-8") as stream:
        print_tables(Console(file=stream, width=_TEXT_WIDTH), tables)
    if session.json_output:
        session.print_json(document)
    else:
        print_tables(session.results, tables)
    session.messages.print(f"In {escape(str(out))}: report.txt, report.json, rows.jsonl")


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


def _run(evaluation: Evaluation, session: Session) -> list[Row]:
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
