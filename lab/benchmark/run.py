"""Runs the parts one after the other, and writes figures and tables."""

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from json import dumps
from pathlib import Path
from typing import Any

import torch
from rich.markup import escape

from panoloc.core.errors import OptionsError
from panoloc.core.kernels.library import use_threads
from panoloc.lab.benchmark.core_parts import CORE_PARTS, CoreBenchmark, chosen_device
from panoloc.lab.benchmark.painted_maps import Rooms
from panoloc.lab.benchmark.service_parts import SERVICE_PARTS, ServiceBenchmark, service_benchmark
from panoloc.lab.benchmark.sizes import Sizes
from panoloc.lab.benchmark.tables import tables_of
from panoloc.lab.display import progress, show_report
from panoloc.lab.machine import machine, versions
from panoloc.service.cli.session import Session
from panoloc.service.host.process_resources import num_usable_cpus

_BUSY_LOAD = 0.25  # of the processors


@dataclass(frozen=True)
class BenchRequest:
    """What to measure. lab/commands/bench.py says what each option means.

    parts: empty for all. quick: whether the sizes are those that only show that everything runs.
    """

    parts: tuple[str, ...]
    sizes: Sizes
    quick: bool
    large_points: int | None
    scan_formats: tuple[str, ...]
    paper: bool
    url: str | None
    device: str | None
    threads: int | None
    out: Path


def run_bench(request: BenchRequest, session: Session) -> None:
    """Measure the chosen parts and print their tables; figures are written after each part, so that an interruption loses one.

    Raises a CoreError for options that do not fit and a ClientError when the service fails.
    """
    device = chosen_device(request.device)
    names = _chosen_parts(request, session)
    use_threads(request.threads or num_usable_cpus())
    document = _description(request, device)
    _warn_when_busy(document["machine"], session)
    request.out.mkdir(parents=True, exist_ok=True)
    for name, figures in _measured(request, session, names, device):
        document["parts"][name] = figures
        (request.out / "bench.json").write_text(dumps(document, indent=1) + "\n", encoding="utf-8")
        session.messages.print(f"{name}: measured in {figures['measured_in_s']:.0f} s")
    show_report(session, request.out, "bench", document, tables_of(document))
    session.messages.print(f"In {escape(str(request.out))}: bench.txt, bench.json")


def _measured(
    request: BenchRequest, session: Session, names: Sequence[str], device: torch.device
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of one part after the other and its figures; a service is started before the first part that needs one."""
    with ExitStack() as stack:
        say, advance = stack.enter_context(progress(session.messages, len(names)))
        core = CoreBenchmark(request.sizes, device, Rooms(device, say), say, request.large_points, request.scan_formats)
        service: ServiceBenchmark | None = None
        for name in names:
            if name in SERVICE_PARTS and service is None:
                on_cpu = request.device == "cpu"
                service = stack.enter_context(
                    service_benchmark(
                        request.sizes, session, request.url, request.out, paper=request.paper, on_cpu=on_cpu, say=say
                    )
                )
            began = time.perf_counter()
            figures = CORE_PARTS[name](core) if service is None else SERVICE_PARTS[name](service)
            yield name, {**figures, "measured_in_s": time.perf_counter() - began}
            advance()


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
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": ["panoloc", *sys.argv[1:]],
        "machine": {**machine(), "device": str(device), "load_average": os.getloadavg()[0]},
        "versions": versions(),
        "quick": request.quick,
        "sizes": asdict(request.sizes),
        "parts": {},
    }


def _warn_when_busy(described: dict[str, Any], session: Session) -> None:
    load, cpus = described["load_average"], described["cpu_count"] or 1
    if load > _BUSY_LOAD * cpus:
        session.messages.print(
            f"This machine is busy ({load:.1f} processes on {cpus} processors): times will be too long; trust ratios."
        )
