"""`panoloc bench`: measure how fast everything is on this machine, from the search alone to queries over HTTP."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from lab.commands.core_errors import core_errors_shown
from service.cli.exit_codes import ExitCode
from service.cli.session import JsonOption, Session
from service.host.process_resources import bound_spinning

WHAT, SIZES, SERVICE, MACHINE, OUTPUT = "What", "Sizes", "Service", "Machine", "Output"


class Part(StrEnum):
    """What can be measured by itself."""

    SEARCH = "search"
    STAGES = "stages"
    REGISTRATION = "registration"
    INDEX = "index"
    MAPS = "maps"
    SCALING = "scaling"
    QUERY = "query"
    CAMERAS = "cameras"
    MEMORY = "memory"


class Device(StrEnum):
    """What computes."""

    CPU = "cpu"
    CUDA = "cuda"


def bench(
    ctx: typer.Context,
    parts: Annotated[
        list[Part] | None, typer.Option("--part", help="Only this part; repeatable.", rich_help_panel=WHAT)
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Everything tiny: shows that all of it runs.", rich_help_panel=WHAT)
    ] = False,
    repeats: Annotated[
        int | None, typer.Option(min=1, help="Repetitions of a figure; 9.", rich_help_panel=WHAT)
    ] = None,
    points: Annotated[
        int | None, typer.Option(min=1000, help="Points of the scan; 1,000,000.", rich_help_panel=SIZES)
    ] = None,
    large_points: Annotated[
        int | None, typer.Option(min=1000, help="Register a second scan, of so many points.", rich_help_panel=SIZES)
    ] = None,
    starts: Annotated[
        int | None, typer.Option(min=4, max=800, help="Starts, by their spacing; about 400.", rich_help_panel=SIZES)
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=128, max=16384, help="Pixels of the panorama; 2048.", rich_help_panel=SIZES)
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="A running service; one is started otherwise.", rich_help_panel=SERVICE)
    ] = None,
    clients: Annotated[
        list[int] | None,
        typer.Option(min=1, max=256, help="Clients at the same time; repeatable; 1, 4, 16.", rich_help_panel=SERVICE),
    ] = None,
    queries: Annotated[
        int | None, typer.Option(min=1, help="Queries for each number of clients; 48.", rich_help_panel=SERVICE)
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper/--no-paper", help="Also one query of the method paper.", rich_help_panel=SERVICE)
    ] = True,
    paper_timeout_s: Annotated[
        float, typer.Option("--paper-timeout", min=1, help="Seconds for that query.", rich_help_panel=SERVICE)
    ] = 1800.0,
    device: Annotated[
        Device | None, typer.Option(help="What computes; a GPU where there is one.", rich_help_panel=MACHINE)
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of the parts without a service.", rich_help_panel=MACHINE)
    ] = None,
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder of figures, tables and plots.", rich_help_panel=OUTPUT)
    ] = Path("panoloc-bench"),
    json: JsonOption = False,
) -> int:
    """Measure the speed of search, queries and registrations in made-up rooms: tables, JSON and plots.

    Needs no files. Takes about half an hour on two cores, with --quick about a minute.
    """
    session: Session = ctx.obj
    session.json_output = json
    with core_errors_shown(session) as failed:
        bound_spinning()
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from lab.benchmark.request import BenchRequest
        from lab.benchmark.run import run_bench

        request = BenchRequest(
            parts=tuple(str(part) for part in parts or ()),
            quick=quick,
            points=points,
            large_points=large_points,
            starts=starts,
            width=width,
            repeats=repeats,
            queries=queries,
            clients=tuple(clients or ()),
            paper=paper,
            paper_timeout_s=paper_timeout_s,
            url=url,
            device=None if device is None else str(device),
            threads=threads,
            out=out,
        )
        run_bench(request, session)
    return ExitCode.ERROR if failed else ExitCode.OK
