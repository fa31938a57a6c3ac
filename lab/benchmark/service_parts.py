"""The parts of the benchmark that need a running service, by name. Each returns JSON-safe figures."""

import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from panoloc.lab.background_service import own_service, wait_until_ready
from panoloc.lab.benchmark.cameras import measure_cameras
from panoloc.lab.benchmark.painted_maps import room_spacing, write_room_scan
from panoloc.lab.benchmark.painted_room import PaintedRoom
from panoloc.lab.benchmark.query_load import KnownQuery, LoadFigures, load_figures
from panoloc.lab.benchmark.sizes import Sizes
from panoloc.lab.benchmark.timing import Say
from panoloc.lab.benchmark.whole_query import encode_jpeg
from panoloc.lab.process_memory import family_bytes
from panoloc.service.cli.session import Session
from panoloc.service.client import ClientError, JsonClient, JsonObject

Figures = dict[str, Any]

_TIMEOUT_S = 600.0
_PAPER_TIMEOUT_S = 1800.0
_SAMPLE_S = 0.5


@dataclass(frozen=True)
class ServiceBenchmark:
    """A service and a painted room to localize in.

    process_id: None for the service at `--url`. place: the map of the room. queries: panoramas of it. paper: whether to send
    one of them to the method paper. say: receives what is under way.
    """

    sizes: Sizes
    session: Session
    url: str
    process_id: int | None
    place: JsonObject
    queries: tuple[KnownQuery, ...]
    paper: bool
    say: Say

    def send(self, clients: int, number: int) -> LoadFigures:
        """Send `number` queries of the method `fast`, the panoramas in turn."""
        chosen = [self.queries[k % len(self.queries)] for k in range(number)]
        return load_figures(self.session, self.url, chosen, clients)

    def warm_up(self) -> None:
        """Send every panorama once, so that the map is in the worker's memory and everything is loaded."""
        self.say("warming up the service")
        self.send(1, len(self.queries))


@contextmanager
def service_benchmark(
    sizes: Sizes, session: Session, url: str | None, out: Path, *, paper: bool, on_cpu: bool, say: Say
) -> Iterator[ServiceBenchmark]:
    """Start a service unless `url` names one, register the room in it, and stop the service or delete the map at the end.

    out: folder of the service's log. on_cpu: a service of our own sees no GPU.
    Raises a ClientError when the service cannot be reached or started, or refuses the scan.
    """
    with ExitStack() as stack:
        process_id = None
        if url is None:
            settings = {"PANOLOC_MAX_TIMEOUT_S": f"{_PAPER_TIMEOUT_S:g}"}
            # Workers take a GPU where they see one.
            settings |= {"CUDA_VISIBLE_DEVICES": ""} if on_cpu else {}
            service = stack.enter_context(own_service(settings, out / "service.log", say))
            url, process_id = service.url, service.process_id
        client = stack.enter_context(session.client(url))
        wait_until_ready(client, None, say)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="panoloc-bench-")))
        place, queries = _make_room(client, folder, sizes, stack, say)
        yield ServiceBenchmark(sizes, session, url, process_id, place, queries, paper, say)


def _make_room(
    client: JsonClient, folder: Path, sizes: Sizes, stack: ExitStack, say: Say
) -> tuple[JsonObject, tuple[KnownQuery, ...]]:
    """Register a painted room, whose map `stack` deletes at the end, and return the map and queries in it."""
    room, scan = PaintedRoom(0), folder / "room.ply"
    write_room_scan(scan, room, sizes.points, say)
    spacing_m = round(room_spacing(sizes.points, sizes.starts), 4)
    say("registering the room")
    place = client.register_map(scan, {"name": "bench", "tags": ["bench"], "starts": {"spacing_m": spacing_m}})
    stack.callback(client.delete_map, place["id"])
    queries = []
    for number in range(sizes.num_panoramas):
        say(f"taking panorama {number + 1} of {sizes.num_panoramas}")
        pose, file = room.pose(number), folder / f"panorama-{number}.jpg"
        file.write_bytes(encode_jpeg(room.panorama(pose, sizes.width)))
        queries.append(KnownQuery((file,), place["id"], pose, {"timeout_s": _TIMEOUT_S}))
    ready = client.wait_for_map(
        place["id"], lambda now: say(f"registering the room: {now['status']} {now.get('stage') or ''}")
    )
    return ready, tuple(queries)


def _query(run: ServiceBenchmark) -> Figures:
    """Measure whole queries over HTTP: by the number of clients, and one of the paper's method."""
    run.warm_up()
    rows = []
    for clients in run.sizes.clients:
        run.say(f"{run.sizes.queries} queries from {clients} clients")
        rows.append(run.send(clients, max(clients, run.sizes.queries)))
    stats, names = run.place["stats"], ("num_points", "num_points_used", "num_starts", "index_bytes", "seconds")
    return {
        "url": run.url,
        "map": {name: stats.get(name) for name in names},
        "panorama_width": run.sizes.width,
        "rows": [asdict(row) for row in rows],
        "paper": _paper_query(run, rows[0]) if run.paper else None,
    }


def _paper_query(run: ServiceBenchmark, fast: LoadFigures) -> Figures:
    """Send one query of the paper's method; `ratio`: how many times as long it took as the median of `fast`."""
    run.say("one query of the method paper, which takes minutes")
    known = run.queries[0]
    query = KnownQuery(known.images, known.map_id, known.pose, {"method": "paper", "timeout_s": _PAPER_TIMEOUT_S})
    try:
        paper = load_figures(run.session, run.url, [query], 1, "paper")
    except ClientError as error:
        # Hours of other figures must not be lost for this one.
        run.session.messages.print(f"method paper: {error}", markup=False)
        return {"error": str(error), "ratio": None}
    return {**asdict(paper), "ratio": paper.latency.median_ms / fast.latency.median_ms}


def _cameras(run: ServiceBenchmark) -> Figures:
    """Measure what a photo and frames take beside a full panorama."""
    rows = measure_cameras(run.session, run.url, run.sizes, run.say)
    return {"url": run.url, "points": run.sizes.camera_points, "rows": rows}


def _memory(run: ServiceBenchmark) -> Figures:
    """Measure the proportional memory (PSS) of the service's processes: idle, at most while it answers, and idle again."""
    assert run.process_id is not None, "the memory of a service at --url is not measured"
    run.warm_up()
    run.say("memory of the idle service")
    time.sleep(run.sizes.idle_s)
    idle = family_bytes(run.process_id)
    samples = [sum(idle.values())]
    run.say(f"memory under {run.sizes.queries} queries")
    with ThreadPoolExecutor(1) as thread:
        sending = thread.submit(run.send, 1, run.sizes.queries)
        while not sending.done():
            samples.append(sum(family_bytes(run.process_id).values()))
            wait([sending], _SAMPLE_S)
        sending.result()
    run.say("memory of the service, idle again")
    time.sleep(run.sizes.idle_s)
    after = family_bytes(run.process_id)
    return {
        "queries": run.sizes.queries,
        "idle_bytes": sum(idle.values()),
        "peak_bytes": max(*samples, sum(after.values())),
        "after_bytes": sum(after.values()),
        "idle_by_process": idle,
        "after_by_process": after,
    }


SERVICE_PARTS: dict[str, Callable[[ServiceBenchmark], Figures]] = {
    "query": _query,
    "cameras": _cameras,
    "memory": _memory,
}
