"""`panoloc evaluate`: measure methods on cases with known poses, and fit the confidence on the rows. Runs here, without a service."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from service.cli.core_errors import core_errors_shown
from service.cli.exit_codes import ExitCode
from service.cli.options import JsonOption
from service.cli.session import Session

app = typer.Typer(help="Measure methods on cases with known poses, and fit the confidence on the rows.")
SOURCES, METHODS, OUTPUT = "Cases", "Methods", "Output"


@app.callback(invoke_without_command=True)
def evaluate(
    ctx: typer.Context,
    suites: Annotated[
        list[str] | None, typer.Option("--suite", help="Procedural suite; repeatable.", rich_help_panel=SOURCES)
    ] = None,
    seeds: Annotated[
        str, typer.Option(help="Seeds of the suites: 1000-1019, or 1,3,5-8.", rich_help_panel=SOURCES)
    ] = "1000-1019",
    families: Annotated[
        list[str] | None,
        typer.Option("--family", help="Style family of the suites; repeatable.", rich_help_panel=SOURCES),
    ] = None,
    width: Annotated[int, typer.Option(min=128, help="Pixels of a suite's panorama.", rich_help_panel=SOURCES)] = 1024,
    points: Annotated[
        int | None, typer.Option(min=1000, help="Points of a suite's scan.", rich_help_panel=SOURCES)
    ] = None,
    cases: Annotated[
        list[Path] | None,
        typer.Option(help="Folder with truth.json in it or one below; repeatable.", rich_help_panel=SOURCES),
    ] = None,
    tags: Annotated[
        list[str] | None, typer.Option("--tag", help="Only queries of --cases with it.", rich_help_panel=SOURCES)
    ] = None,
    dataset: Annotated[
        str | None,
        typer.Option(help="omniscenes, stanford2d3ds, structured3d or data61.", rich_help_panel=SOURCES),
    ] = None,
    root: Annotated[Path | None, typer.Option(help="Folder of the data set.", rich_help_panel=SOURCES)] = None,
    split: Annotated[
        list[str] | None, typer.Option(help="Split of the data set; repeatable.", rich_help_panel=SOURCES)
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Queries per suite, case folder or split.", rich_help_panel=SOURCES)
    ] = None,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help="fast, paper, paper-no-…, piccolo, or NAME=BASE:section.field=value; repeatable; fast and paper when left out.",
            rich_help_panel=METHODS,
        ),
    ] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.", rich_help_panel=METHODS)] = None,
    timeout_s: Annotated[
        float | None, typer.Option(min=0.1, help="Limit of one answer.", rich_help_panel=METHODS)
    ] = None,
    spacing_m: Annotated[
        float | None, typer.Option(help="Metres between starts of suites.", rich_help_panel=METHODS)
    ] = None,
    cross: Annotated[
        int, typer.Option(min=0, help="Also send each panorama to this many other maps.", rich_help_panel=METHODS)
    ] = 0,
    change_maps: Annotated[
        bool, typer.Option("--change-maps", help="Measure the maps of what changed.", rich_help_panel=METHODS)
    ] = False,
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder of rows, report and plots.", rich_help_panel=OUTPUT)
    ] = Path("panoloc-evaluation"),
    limits: Annotated[
        list[str] | None,
        typer.Option("--within", help="Limits such as 0.05,5 (m, deg); repeatable.", rich_help_panel=OUTPUT),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Measure methods on cases with known poses: the paper's tables as text and JSON, plots, and rows to continue from.

    Rows that --out already holds are not run again. PANOLOC_EVAL_THREADS: threads to compute with, all processors otherwise.
    """
    if ctx.invoked_subcommand is not None:
        return ExitCode.OK
    session: Session = ctx.obj
    session.json_output = json
    with core_errors_shown(session) as failed:
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from service.cli.evaluation_run import EvaluationRequest, run_evaluation

        request = EvaluationRequest(
            suites=tuple(suites or ()),
            seeds=seeds,
            families=tuple(families or ()),
            width=width,
            num_points=points,
            cases=tuple(cases or ()),
            tags=tuple(tags or ()),
            dataset=dataset,
            root=root,
            splits=tuple(split or ()),
            limit=limit,
            methods=tuple(methods or ("fast", "paper")),
            device=device,
            timeout_s=timeout_s,
            spacing_m=spacing_m,
            num_strangers=cross,
            change_maps=change_maps,
            out=out,
            limits=tuple(limits or ()),
        )
        run_evaluation(request, session)
    return ExitCode.ERROR if failed else ExitCode.OK


@app.command()
def fit(
    ctx: typer.Context,
    files: Annotated[list[Path], typer.Argument(metavar="ROWS...", help="rows.jsonl of evaluations.")],
    out: Annotated[Path, typer.Option(dir_okay=False, help="Where the coefficients go.")] = Path(
        "core/data/confidence.json"
    ),
    method: Annotated[str, typer.Option(help="Rows of this method.")] = "fast",
    regularization: Annotated[float, typer.Option(min=1e-6, help="L2 penalty, in rows.")] = 1.0,
    max_wrong: Annotated[float, typer.Option(min=0, max=1, help="Wrong answers allowed at the threshold.")] = 0.005,
    json: JsonOption = False,
) -> int:
    """Fit the confidence on rows, say how it holds on groups held out in turn, and write the coefficients."""
    session: Session = ctx.obj
    session.json_output = json
    with core_errors_shown(session) as failed:
        from json import dumps

        from core.evaluation import fit_confidence, read_rows
        from service.cli.evaluation_tables import held_out_table

        rows = [row for row in read_rows(files) if row.method == method]
        fitted = fit_confidence(rows, regularization=regularization, max_wrong=max_wrong)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(dumps(fitted.document, indent=1) + "\n", encoding="utf-8")
        if json:
            session.print_json({"confidence": fitted.document, "held_out": asdict(fitted.held_out)})
        else:
            session.results.print(held_out_table(fitted.held_out))
        session.messages.print(f"wrote {escape(str(out))}")
    return ExitCode.ERROR if failed else ExitCode.OK
