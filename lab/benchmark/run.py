"""Runs the parts one after the other, and writes figures, tables and plots."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from json import dumps
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from core.errors import OptionsError
from lab.benchmark.method.parts import CORE_PARTS, CoreBenchmark, chosen_device, run_core_part
from lab.benchmark.plots import write_plots
from lab.benchmark.request import BenchRequest
from lab.benchmark.rooms import Rooms
from lab.benchmark.service.measured_service import measured_service
from lab.benchmark.service.parts import SERVICE_PARTS, ServiceBenchmark
from lab.benchmark.service.redis_load import NoRedisError, time_redis
from lab.benchmark.tables import tables_of
from lab.benchmark.timing import Say
from lab.machine import machine, versions
from service.cli.session import Session

REPORT_JSON, REPORT_TEXT = "bench.json", "bench.txt"
_TEXT_WIDTH = 240
_BUSY_LOAD = 0.25  # of the processors


def run_bench(request: BenchRequest, session: Session) -> None:
    """Measure the chosen parts and print their tables; figures are written after each part, so that an interruption loses one.

    Raises a CoreError for options that do not fit and a ClientError when the service fails.
    """
    device = chosen_device(request.device)
    names = _chosen_parts(request, session)
    if request.threads is not None:
        torch.set_num_threads(request.threads)
    document = _description(request, device)
    _warn_when_busy(document["machine"], session)
    request.out.mkdir(parents=True, exist_ok=True)
    with _progress(session, len(names)) as progress:
        run = _Run(request, session, progress, document)
        run.core_parts([name for name in names if name in CORE_PARTS], device)
        run.service_parts([name for name in names if name in SERVICE_PARTS])
    tables = tables_of(document)
    with (request.out / REPORT_TEXT).open("w", encoding="utf-8") as stream:
        _print_tables(Console(file=stream, width=_TEXT_WIDTH), tables)
    if session.json_output:
        session.print_json(document)
    else:
        _print_tables(session.results, tables)
    _say_what_was_written(document, request.out, session)


class _Progress:
    """A bar of parts, with what is under way; parts that are done are also said where nobody sees a bar."""

    def __init__(self, bar: Progress, num_parts: int, console: Console) -> None:
        self._bar, self._console = bar, console
        self._task = bar.add_task("", total=num_parts)

    def say(self, text: str) -> None:
        """Show what is under way."""
        self._bar.update(self._task, description=escape(text))

    def done(self, name: str, seconds: float) -> None:
        """Count a part."""
        self._bar.advance(self._task)
        self._console.print(f"{name}: measured in {seconds:.0f} s")


class _Run:
    """One run of the benchmark; adds to the document part by part and writes it each time."""

    def __init__(self, request: BenchRequest, session: Session, progress: _Progress, document: dict[str, Any]) -> None:
        self._request, self._session, self._progress, self._document = request, session, progress, document

    def core_parts(self, names: list[str], device: torch.device) -> None:
        """Measure parts in this process."""
        say: Say = self._progress.say
        sizes = self._request.sizes
        run = CoreBenchmark(sizes, device, Rooms(device, say), say, self._request.large_points)
        for name in names:
            with self._part(name) as figures:
                figures.update(run_core_part(name, run))
                if name == "index":
                    figures["redis"] = self._redis(run)

    def service_parts(self, names: list[str]) -> None:
        """Measure parts with one service for all of them."""
        if not names:
            return
        with measured_service(self._request, self._session, self._progress.say) as service:
            run = ServiceBenchmark(self._request, self._session, service, self._progress.say)
            for name in names:
                with self._part(name) as figures:
                    figures.update(SERVICE_PARTS[name](run))

    @contextmanager
    def _part(self, name: str) -> Iterator[dict[str, Any]]:
        """Yield what is to be filled with the figures of a part, and write them at the end."""
        figures: dict[str, Any] = {}
        began = time.perf_counter()
        yield figures
        seconds = time.perf_counter() - began
        self._document["parts"][name] = {**figures, "measured_in_s": seconds}
        text = dumps(self._document, indent=1) + "\n"
        (self._request.out / REPORT_JSON).write_text(text, encoding="utf-8")
        self._progress.done(name, seconds)

    def _redis(self, run: CoreBenchmark) -> dict[str, Any] | None:
        run.say("loading an index from Redis")
        index = run.rooms.indexed(0, run.sizes.points, run.sizes.starts).index
        try:
            return asdict(time_redis(index, run.sizes, run.device))
        except NoRedisError as error:
            self._session.messages.print(str(error), markup=False)
            return None


def _chosen_parts(request: BenchRequest, session: Session) -> list[str]:
    """Return the parts in the order in which they run. Raises OptionsError for the memory of somebody else's service."""
    known = [*CORE_PARTS, *SERVICE_PARTS]
    if request.url is None or not (request.parts == () or "memory" in request.parts):
        return [name for name in known if not request.parts or name in request.parts]
    if request.parts:
        raise OptionsError("memory: expected a service that this command starts itself; leave --url or this part out")
    session.messages.print("memory is left out: only that of a service started by this command can be measured.")
    return [name for name in known if name != "memory"]


def _description(request: BenchRequest, device: torch.device) -> dict[str, Any]:
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": ["panoloc", *sys.argv[1:]],
        "machine": {**machine(), "device": str(device), "load_average": load},
        "versions": versions(),
        "quick": request.quick,
        "sizes": asdict(request.sizes),
        "parts": {},
    }


def _warn_when_busy(described: dict[str, Any], session: Session) -> None:
    load, cpus = described["load_average"], described["cpu_count"] or 1
    if load is not None and load > _BUSY_LOAD * cpus:
        session.messages.print(
            f"This machine is busy ({load:.1f} processes on {cpus} processors): times will be too long; trust ratios."
        )


@contextmanager
def _progress(session: Session, num_parts: int) -> Iterator[_Progress]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console = session.messages
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        yield _Progress(bar, num_parts, console)


def _print_tables(console: Console, tables: list[object]) -> None:
    for table in tables:
        console.print(table)
        console.print()


def _say_what_was_written(document: dict[str, Any], out: Path, session: Session) -> None:
    written = [REPORT_TEXT, REPORT_JSON]
    if "scaling" in document["parts"]:
        plots = write_plots(document["parts"]["scaling"]["rows"], out)
        if plots is None:
            session.messages.print("No plots: matplotlib is not installed (pip install 'panoloc\\[plots]').")
        else:
            written += [path.name for path in plots]
    session.messages.print(f"In {escape(str(out))}: {', '.join(written)}")
