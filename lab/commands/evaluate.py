"""`panoloc evaluate`: measure methods on cases with known poses, and fit the confidence on the rows. Runs here, without a service."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from lab.commands import evaluation_options as choices
from lab.commands.core_errors import core_errors_shown
from service.cli.exit_codes import ExitCode
from service.cli.session import JsonOption, Session
from service.host.process_resources import bound_spinning

app = typer.Typer(help="Measure methods on cases with known poses, and fit the confidence on the rows.")


@app.callback(invoke_without_command=True)
def evaluate(
    ctx: typer.Context,
    suites: choices.Suites = None,
    seeds: choices.Seeds = "1000-1019",
    families: choices.Families = None,
    cameras: choices.Cameras = None,
    width: choices.Width = 1024,
    points: choices.Points = None,
    cases: choices.Cases = None,
    tags: choices.Tags = None,
    dataset: choices.Dataset = None,
    root: choices.Root = None,
    splits: choices.Splits = None,
    limit: choices.Limit = None,
    methods: choices.Methods = None,
    device: choices.Device = None,
    timeout_s: choices.TimeoutS = None,
    spacing_m: choices.SpacingM = None,
    cross: choices.Cross = 0,
    change_maps: choices.ChangeMaps = False,
    out: choices.Out = Path("panoloc-evaluation"),
    within: choices.Within = None,
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
        bound_spinning()
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from lab.commands.evaluation_run import EvaluationRequest, run_evaluation

        request = EvaluationRequest(
            suites=tuple(suites or ()),
            seeds=seeds,
            families=tuple(families or ()),
            cameras=tuple(cameras or ()),
            width=width,
            num_points=points,
            cases=tuple(cases or ()),
            tags=tuple(tags or ()),
            dataset=dataset,
            root=root,
            splits=tuple(splits or ()),
            limit=limit,
            methods=tuple(methods or ("fast", "paper")),
            device=device,
            timeout_s=timeout_s,
            spacing_m=spacing_m,
            num_strangers=cross,
            change_maps=change_maps,
            out=out,
            limits=tuple(within or ()),
        )
        run_evaluation(request, session)
    return ExitCode.ERROR if failed else ExitCode.OK


@app.command()
def fit(
    ctx: typer.Context,
    files: Annotated[list[Path], typer.Argument(metavar="ROWS...", help="rows.jsonl of evaluations.")],
    out: Annotated[Path, typer.Option(dir_okay=False, help="Where the coefficients go.")] = Path(
        "core/judge/confidence.json"
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

        from lab.commands.evaluation_tables import held_out_table
        from lab.evaluation import fit_confidence, read_rows

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
    return ExitCode.ERROR if failed else ExitCode.OK
