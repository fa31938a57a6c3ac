"""`panoloc bench`: measure how fast everything is on this machine, from stages of a query to queries over HTTP."""

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from panoloc.lab.benchmark.sizes import FULL, QUICK
from panoloc.lab.commands.core_errors import core_errors_shown
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import JsonOption, Session
from panoloc.service.host.process_resources import bound_spinning

_WHAT, _SIZES, _SERVICE, _MACHINE, _OUTPUT = "What", "Sizes", "Service", "Machine", "Output"


class Part(StrEnum):
    """What can be measured by itself."""

    STAGES = "stages"
    REGISTRATION = "registration"
    INDEX = "index"
    MAPS = "maps"
    QUERY = "query"
    CAMERAS = "cameras"
    MEMORY = "memory"


class Device(StrEnum):
    """What computes."""

    CPU = "cpu"
    CUDA = "cuda"


class ScanFormat(StrEnum):
    """What a large scan is written as."""

    PLY = "ply"
    LAZ = "laz"
    E57 = "e57"


def bench(
    ctx: typer.Context,
    parts: Annotated[
        list[Part] | None, typer.Option("--part", help="Only this part; repeatable.", rich_help_panel=_WHAT)
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Tiny sizes: a functional test.", rich_help_panel=_WHAT)
    ] = False,
    repeats: Annotated[
        int | None, typer.Option(min=1, help="Repetitions of a figure; 9.", rich_help_panel=_WHAT)
    ] = None,
    points: Annotated[
        int | None, typer.Option(min=1000, help="Points of the scan; 1,000,000.", rich_help_panel=_SIZES)
    ] = None,
    large_points: Annotated[
        int | None, typer.Option(min=1000, help="Also register a scan with this many points.", rich_help_panel=_SIZES)
    ] = None,
    scan_formats: Annotated[
        list[ScanFormat] | None,
        typer.Option("--scan-format", help="Format of the large scan; repeatable; ply.", rich_help_panel=_SIZES),
    ] = None,
    starts: Annotated[
        int | None, typer.Option(min=4, max=800, help="Starts, by their spacing; about 400.", rich_help_panel=_SIZES)
    ] = None,
    width: Annotated[
        int | None, typer.Option(min=128, max=16384, help="Pixels of the panorama; 2048.", rich_help_panel=_SIZES)
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="A running service; one is started otherwise.", rich_help_panel=_SERVICE)
    ] = None,
    clients: Annotated[
        list[int] | None,
        typer.Option(min=1, max=256, help="Clients at the same time; repeatable; 1, 4, 16.", rich_help_panel=_SERVICE),
    ] = None,
    queries: Annotated[
        int | None, typer.Option(min=1, help="Queries for each number of clients; 48.", rich_help_panel=_SERVICE)
    ] = None,
    paper: Annotated[
        bool,
        typer.Option("--paper/--no-paper", help="Also send one query with the method paper.", rich_help_panel=_SERVICE),
    ] = True,
    device: Annotated[
        Device | None, typer.Option(help="Device; default: a GPU if there is one.", rich_help_panel=_MACHINE)
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of the parts without a service.", rich_help_panel=_MACHINE)
    ] = None,
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder of figures and tables.", rich_help_panel=_OUTPUT)
    ] = Path("panoloc-bench"),
    json: JsonOption = False,
) -> int:
    """Measure the speed of search, queries and registrations in procedural rooms: tables and JSON.

    Needs no files. Takes about half an hour on two cores, with --quick about a minute.
    """
    session: Session = ctx.obj
    session.json_output = json
    with core_errors_shown(session) as failed:
        bound_spinning()
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from panoloc.lab.benchmark.run import BenchRequest, run_bench

        given: dict[str, Any] = {
            "points": points,
            "starts": starts,
            "width": width,
            "repeats": repeats,
            "queries": queries,
            "clients": tuple(clients) if clients else None,
        }
        sizes = replace(QUICK if quick else FULL, **{name: value for name, value in given.items() if value is not None})
        request = BenchRequest(
            parts=tuple(map(str, parts or ())),
            sizes=sizes,
            quick=quick,
            large_points=large_points,
            scan_formats=tuple(map(str, scan_formats or ("ply",))),
            paper=paper,
            url=url,
            device=None if device is None else str(device),
            threads=threads,
            out=out,
        )
        run_bench(request, session)
    return ExitCode.ERROR if failed else ExitCode.OK
