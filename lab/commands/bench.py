"""`panoloc bench`: measure how fast everything is on this machine, from stages of a query to queries over HTTP."""

from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from panoloc.lab.benchmark.sizes import FULL, QUICK
from panoloc.lab.display import session_of
from panoloc.service.cli.session import JsonOption
from panoloc.service.host.process_resources import bound_spinning

# Typer takes no list of literals.
Part = StrEnum("Part", "STAGES REGISTRATION INDEX MAPS QUERY CAMERAS MEMORY")
ScanFormat = StrEnum("ScanFormat", "PLY LAZ E57")
_what, _sizes, _service, _machine, _output = (
    partial(typer.Option, rich_help_panel=panel) for panel in ("What", "Sizes", "Service", "Machine", "Output")
)


def bench(
    ctx: typer.Context,
    parts: Annotated[list[Part] | None, _what("--part", help="Only this part; repeatable.")] = None,
    quick: Annotated[bool, _what("--quick", help="Tiny sizes: a functional test.")] = False,
    repeats: Annotated[int | None, _what(min=1, help="Repetitions of a figure; 9.")] = None,
    points: Annotated[int | None, _sizes(min=1000, help="Points of the scan; 1,000,000.")] = None,
    large_points: Annotated[int | None, _sizes(min=1000, help="Also register a scan with this many points.")] = None,
    scan_formats: Annotated[
        list[ScanFormat] | None, _sizes("--scan-format", help="Format of the large scan; repeatable; ply.")
    ] = None,
    starts: Annotated[int | None, _sizes(min=4, max=800, help="Starts, by their spacing; about 400.")] = None,
    width: Annotated[int | None, _sizes(min=128, max=16384, help="Pixels of the panorama; 2048.")] = None,
    url: Annotated[str | None, _service(help="A running service; one is started otherwise.")] = None,
    clients: Annotated[
        list[int] | None, _service(min=1, max=256, help="Clients at the same time; repeatable; 1, 4, 16.")
    ] = None,
    queries: Annotated[int | None, _service(min=1, help="Queries for each number of clients; 48.")] = None,
    paper: Annotated[bool, _service("--paper/--no-paper", help="Also send one query with the method paper.")] = True,
    device: Annotated[Literal["cpu", "cuda"] | None, _machine(help="Device; default: a GPU if there is one.")] = None,
    threads: Annotated[int | None, _machine(min=1, help="Threads of the parts without a service.")] = None,
    out: Annotated[Path, _output(file_okay=False, help="Folder of figures and tables.")] = Path("panoloc-bench"),
    json: JsonOption = False,
) -> None:
    """Measure the speed of search, queries and registrations in procedural rooms: tables and JSON.

    Needs no files. Takes about half an hour on two cores, with --quick about a minute.
    """
    with session_of(ctx, json) as session:
        bound_spinning()
        # Torch and the algorithm take seconds to import, which the other commands must not pay.
        from panoloc.lab.benchmark.run import BenchRequest, run_bench

        given: dict[str, Any] = {"points": points, "starts": starts, "width": width, "repeats": repeats}
        given |= {"queries": queries, "clients": tuple(clients) if clients else None}
        sizes = replace(QUICK if quick else FULL, **{name: value for name, value in given.items() if value is not None})
        request = BenchRequest(
            parts=tuple(map(str, parts or ())),
            sizes=sizes,
            quick=quick,
            large_points=large_points,
            scan_formats=tuple(map(str, scan_formats or ("ply",))),
            paper=paper,
            url=url,
            device=device,
            threads=threads,
            out=out,
        )
        run_bench(request, session)
