"""`panoloc evaluate`: measure methods on cases with known poses, fit the confidence on the rows, and vary parameters.

Runs here, without a service.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from panoloc.core.errors import OptionsError
from panoloc.lab.display import session_of
from panoloc.service.cli.session import JsonOption
from panoloc.service.host.process_resources import bound_spinning

app = typer.Typer(help="Measure methods on cases with known poses, and fit the confidence on the rows.")

_METHODS = (
    "fast, paper, paper-no-…, piccolo, or NAME=BASE:section.field=value; repeatable; fast and paper when left out."
)


_case, _method, _output = (partial(typer.Option, rich_help_panel=panel) for panel in ("Cases", "Methods", "Output"))


@app.callback(invoke_without_command=True)
def evaluate(
    ctx: typer.Context,
    suites: Annotated[list[str] | None, _case("--suite", help="Procedural suite; repeatable.")] = None,
    seeds: Annotated[str, _case(help="Seeds of the suites: 1000-1019, or 1,3,5-8.")] = "1000-1019",
    families: Annotated[list[str] | None, _case("--family", help="Style family of the suites; repeatable.")] = None,
    cameras: Annotated[
        list[str] | None,
        _case("--camera", help="Photos in place of panoramas: photo, frames4, sweep, …; repeatable."),
    ] = None,
    width: Annotated[int, _case(min=128, help="Pixels of a suite's panorama, or of a photo.")] = 1024,
    points: Annotated[int | None, _case(min=1000, help="Points of a suite's scan.")] = None,
    cases: Annotated[list[Path] | None, _case(help="Folder with truth.json in it or one below; repeatable.")] = None,
    tags: Annotated[list[str] | None, _case("--tag", help="Only queries of --cases with this tag.")] = None,
    dataset: Annotated[str | None, _case(help="omniscenes or stanford2d3ds.")] = None,
    root: Annotated[Path | None, _case(help="Folder of the data set.")] = None,
    splits: Annotated[list[str] | None, _case("--split", help="Split of the data set; repeatable.")] = None,
    limit: Annotated[int | None, _case(min=1, help="Queries per suite, case folder or split.")] = None,
    methods: Annotated[list[str] | None, _method("--method", help=_METHODS)] = None,
    device: Annotated[str | None, _method(help="cpu or cuda.")] = None,
    timeout_s: Annotated[float | None, _method(min=0.1, help="Timeout per answer.")] = None,
    spacing_m: Annotated[float | None, _method(help="Metres between starts of suites.")] = None,
    cross: Annotated[int, _method(min=0, help="Also send each panorama to this many other maps.")] = 0,
    change_maps: Annotated[bool, _method("--change-maps", help="Measure the change maps.")] = False,
    out: Annotated[Path, _output(file_okay=False, help="Folder of rows and report.")] = Path("panoloc-evaluation"),
    within: Annotated[list[str] | None, _output("--within", help="Limits such as 0.05,5 (m, deg); repeatable.")] = None,
    json: JsonOption = False,
) -> None:
    """Measure methods on cases with known poses: the paper's tables as text and JSON, and rows to continue from.

    Rows that --out already holds are not run again. PANOLOC_EVAL_THREADS: threads to compute with, all processors otherwise.
    """
    if ctx.invoked_subcommand is not None:
        return
    with session_of(ctx, json) as session:
        bound_spinning()
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from panoloc.lab.commands import evaluation_run
        from panoloc.lab.evaluation.datasets import dataset_scans
        from panoloc.lab.evaluation.known_cases import limited
        from panoloc.lab.evaluation.photo_source import as_photos
        from panoloc.lab.evaluation.runner import RunOptions
        from panoloc.lab.evaluation.sources import folder_scans, seed_range, suite_scans

        numbers, taken = seed_range(seeds), cameras or []
        groups = [
            suite_scans(suite, numbers, families=families or (), width=width, num_points=points, spacing_m=spacing_m)
            for suite in _with_cameras(suites or (), taken)
        ]
        of_panoramas = [folder_scans(folder, tags=tuple(tags or ())) for folder in cases or ()]
        if dataset is not None:
            if root is None:
                raise OptionsError("dataset: expected --root with the folder of the data set beside --dataset")
            of_panoramas += [dataset_scans(dataset, root, split) for split in splits or (None,)]
        for scans in of_panoramas:
            groups += [as_photos(scans, camera, numbers, width) for camera in taken] or [scans]
        if not groups:
            raise OptionsError("cases: expected --suite, --cases or --dataset; `panoloc evaluate --help` lists them")
        chosen = [scan for group in groups for scan in limited(group, limit)]
        options = RunOptions(device, cross, change_maps, timeout_s)
        evaluation_run.run_evaluation(chosen, methods or ("fast", "paper"), options, within or (), out, session)


def _with_cameras(suites: Sequence[str], cameras: Sequence[str]) -> list[str]:
    """Return each suite with each camera; a suite that names a camera keeps it."""
    return [
        suite
        for name in suites
        for suite in ([name] if "/" in name or not cameras else [f"{name}/{camera}" for camera in cameras])
    ]


@app.command()
def parameters(
    ctx: typer.Context,
    suites: Annotated[list[str], typer.Option("--suite", help="Procedural suite; repeatable.")],
    seeds: Annotated[str, typer.Option(help="Seeds of the suites: 1000-1019, or 1,3,5-8.")] = "1000-1019",
    cameras: Annotated[list[str] | None, typer.Option("--camera", help="Photos in place of panoramas.")] = None,
    width: Annotated[int, typer.Option(min=128, help="Pixels of a suite's panorama, or of a photo.")] = 1024,
    points: Annotated[int | None, typer.Option(min=1000, help="Points of a suite's scan.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Pattern such as 'judge.*'; repeatable.")] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    out: Annotated[Path, typer.Option(file_okay=False, help="Folder of rows and table.")] = Path("panoloc-parameters"),
    json: JsonOption = False,
) -> None:
    """Halve and double each parameter of a query, and compare the answers with those of the parameters as they are.

    Rows that --out already holds are not run again.
    """
    with session_of(ctx, json) as session:
        bound_spinning()
        from panoloc.lab.commands import parameters_run
        from panoloc.lab.evaluation.sources import seed_range, suite_scans

        scans = [
            scan
            for suite in _with_cameras(suites, cameras or ())
            for scan in suite_scans(suite, seed_range(seeds), width=width, num_points=points)
        ]
        parameters_run.run_parameters(scans, only or (), device, out, session)


@app.command()
def campus(
    ctx: typer.Context,
    sizes: Annotated[list[int] | None, typer.Option("--maps", min=2, help="How many maps; repeatable.")] = None,
    queries: Annotated[int, typer.Option(min=1, help="Queries, evenly spread over the maps.")] = 50,
    camera: Annotated[str | None, typer.Option(help="Photos in place of panoramas: photo, frames6, …")] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    out: Annotated[Path, typer.Option(file_okay=False, help="Folder of maps and rows.")] = Path("panoloc-campus"),
    json: JsonOption = False,
) -> None:
    """Localize queries of changed rooms and flats among many maps, a tenth of which are twins of others.

    Maps that --out already holds are not built again.
    """
    with session_of(ctx, json) as session:
        bound_spinning()
        from panoloc.lab.commands.evaluation_run import run_campus

        run_campus(sizes or [10, 100], queries, camera, device, out, session)


@app.command()
def fit(
    ctx: typer.Context,
    files: Annotated[list[Path], typer.Argument(metavar="ROWS...", help="rows.jsonl of evaluations.")],
    out: Annotated[Path, typer.Option(dir_okay=False, help="File for the coefficients.")] = Path(
        "core/decide/confidence.json"
    ),
    method: Annotated[str, typer.Option(help="Rows of this method.")] = "fast",
    regularization: Annotated[float, typer.Option(min=1e-6, help="L2 penalty, in rows.")] = 1.0,
    max_wrong: Annotated[float, typer.Option(min=0, max=1, help="Wrong answers allowed at the threshold.")] = 0.005,
    json: JsonOption = False,
) -> None:
    """Fit the confidence on rows, cross-validate it by group, and write the coefficients."""
    with session_of(ctx, json) as session:
        from json import dumps

        from panoloc.lab.commands.evaluation_run import held_out_table
        from panoloc.lab.evaluation.fit_confidence import fit_confidence
        from panoloc.lab.evaluation.rows import read_rows

        rows = [row for row in read_rows(files) if row.method == method]
        fitted = fit_confidence(rows, regularization=regularization, max_wrong=max_wrong)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(dumps(fitted.document, indent=1) + "\n", encoding="utf-8")
        if json:
            session.print_json(
                {"confidence": fitted.document, "held_out": asdict(fitted.held_out), "left_out": fitted.left_out}
            )
        else:
            session.results.print(held_out_table(fitted.held_out))
        for why, number in fitted.left_out.items():
            session.messages.print(f"left out: {number} of {len(rows)} rows, {why}")
        session.messages.print(f"wrote {escape(str(out))}")
