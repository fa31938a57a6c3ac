"""The parts of the benchmark that need a running service. Each returns JSON-safe figures."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from lab.benchmark.request import BenchRequest
from lab.benchmark.service.camera_load import measure_cameras
from lab.benchmark.service.measured_service import MeasuredService
from lab.benchmark.service.memory import measure_memory
from lab.benchmark.service.query_load import LoadFigures, send_queries
from lab.benchmark.timing import Say
from service.cli.session import Session
from service.client import ClientError

Figures = dict[str, Any]


@dataclass(frozen=True)
class ServiceBenchmark:
    """What the parts have in common. say: hears what is under way."""

    request: BenchRequest
    session: Session
    service: MeasuredService
    say: Say

    def send(self, clients: int, queries: int) -> LoadFigures:
        """Send queries of the method `fast`."""
        return send_queries(self.service, self.session, clients, queries)

    def warm_up(self) -> None:
        """Send every panorama once, so that the map is in the worker's memory and everything is loaded."""
        self.say("warming up the service")
        self.send(1, len(self.service.panoramas))


def query_part(run: ServiceBenchmark) -> Figures:
    """Measure whole queries over HTTP: by the number of clients, and one of the paper's method."""
    run.warm_up()
    rows = []
    for clients in run.request.num_clients:
        run.say(f"{run.request.num_queries} queries from {clients} clients")
        rows.append(run.send(clients, max(clients, run.request.num_queries)))
    stats = run.service.place.get("stats") or {}
    return {
        "url": run.service.url,
        "map": {
            name: stats.get(name) for name in ("num_points", "num_points_used", "num_starts", "index_bytes", "seconds")
        },
        "panorama_width": run.request.sizes.width,
        "panorama_bytes": [panorama.file.stat().st_size for panorama in run.service.panoramas],
        "rows": [asdict(row) for row in rows],
        "paper": _paper_query(run, rows[0]) if run.request.paper else None,
    }


def cameras_part(run: ServiceBenchmark) -> Figures:
    """Measure what a photo and frames take beside a full panorama."""
    sizes = run.request.sizes
    with run.session.client(run.service.url) as client:
        rows = measure_cameras(client, sizes.width, sizes.camera_rooms, sizes.base_points, sizes.repeats, run.say)
    return {"url": run.service.url, "points": sizes.base_points, "rows": rows}


def memory_part(run: ServiceBenchmark) -> Figures:
    """Measure the memory of the service's processes before, while and after they answer queries."""
    if run.service.process_id is None:
        raise ValueError("memory: expected a service of our own")
    run.warm_up()
    return asdict(measure_memory(run.service.process_id, run.request, run.say, lambda num: run.send(1, num)))


def _paper_query(run: ServiceBenchmark, fast: LoadFigures) -> Figures:
    """Send one query of the paper's method; `ratio`: how many times as long it took as the median of `fast`."""
    run.say("one query of the method paper, which takes minutes")
    try:
        paper = send_queries(run.service, run.session, 1, 1, method="paper", timeout_s=run.request.paper_timeout_s)
    except ClientError as error:
        # Hours of other figures must not be lost for this one.
        run.session.messages.print(f"method paper: {error}", markup=False)
        return {"error": str(error), "ratio": None}
    return {**asdict(paper), "ratio": paper.latency.median_ms / fast.latency.median_ms}


SERVICE_PARTS: dict[str, Callable[[ServiceBenchmark], Figures]] = {
    "query": query_part,
    "cameras": cameras_part,
    "memory": memory_part,
}
