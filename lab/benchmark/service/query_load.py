"""Send queries to a service from several clients at the same time, and measure what each waited."""

import queue
import statistics
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from core.geometry.pose import Pose, pose_error
from lab.benchmark.service.measured_service import KnownPanorama, MeasuredService
from lab.benchmark.timing import Spread, spread_of
from service.cli.session import Session
from service.client import ClientError, JsonObject

ANSWER_TIMEOUT_S = 600.0


@dataclass(frozen=True)
class LoadFigures:
    """What `clients` at the same time got, all figures of the answers that came.

    latency: from sending the first byte to the end of the answer. failed: queries that got no answer; last_error says why.
    localized: answers with this status. max_position_error_m: the most by which an answer was off, None when none had a pose.
    service_stages_ms: medians of what the service says of itself.
    """

    method: str
    clients: int
    queries: int
    failed: int
    localized: int
    max_position_error_m: float | None
    latency: Spread
    throughput_per_s: float
    service_stages_ms: Mapping[str, float]
    last_error: str | None


@dataclass(frozen=True)
class _Answer:
    """One answer, the milliseconds that it took, and how far off it was, metres."""

    milliseconds: float
    body: JsonObject
    error_m: float | None


def send_queries(
    service: MeasuredService,
    session: Session,
    num_clients: int,
    num_queries: int,
    *,
    method: str = "fast",
    timeout_s: float = ANSWER_TIMEOUT_S,
) -> LoadFigures:
    """Send `num_queries` in all, each client the next one as soon as its last was answered.

    Raises the last ClientError when no query is answered at all.
    """
    waiting: queue.SimpleQueue[KnownPanorama] = queue.SimpleQueue()
    for number in range(num_queries):
        waiting.put(service.panoramas[number % len(service.panoramas)])
    options = {"method": method, "timeout_s": timeout_s}
    began = time.perf_counter()
    with ThreadPoolExecutor(num_clients) as threads:
        running = [threads.submit(_one_client, service, session, waiting, options) for _ in range(num_clients)]
        try:
            results = [result for thread in running for result in thread.result()]
        except BaseException:
            _empty(waiting)  # who interrupts does not want to wait for the queries that are left
            raise
    wall_s = time.perf_counter() - began
    answers = [result for result in results if isinstance(result, _Answer)]
    errors = [result for result in results if isinstance(result, ClientError)]
    if not answers:
        raise errors[-1]
    off = [answer.error_m for answer in answers if answer.error_m is not None]
    return LoadFigures(
        method=method,
        clients=num_clients,
        queries=num_queries,
        failed=len(errors),
        localized=sum(answer.body["status"] == "localized" for answer in answers),
        max_position_error_m=max(off, default=None),
        latency=spread_of([answer.milliseconds for answer in answers]),
        throughput_per_s=len(answers) / wall_s,
        service_stages_ms=_stage_medians(answers),
        last_error=str(errors[-1]) if errors else None,
    )


def _one_client(
    service: MeasuredService, session: Session, waiting: "queue.SimpleQueue[KnownPanorama]", options: JsonObject
) -> list[_Answer | ClientError]:
    found: list[_Answer | ClientError] = []
    with session.client(service.url) as client:
        while True:
            try:
                panorama = waiting.get_nowait()
            except queue.Empty:
                return found
            began = time.perf_counter()
            try:
                body = client.localize(panorama.file, [service.place["id"]], options=options)
            except ClientError as error:
                found.append(error)
            else:
                milliseconds = (time.perf_counter() - began) * 1000
                found.append(_Answer(milliseconds, body, _error_m(body, panorama.pose)))


def _empty(waiting: "queue.SimpleQueue[KnownPanorama]") -> None:
    with suppress(queue.Empty):
        while True:
            waiting.get_nowait()


def _error_m(body: JsonObject, truth: Pose) -> float | None:
    if not body.get("pose"):
        return None
    matrix = np.asarray(body["pose"]["map_from_camera"]["matrix"], np.float64)
    return pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), truth).position_m


def _stage_medians(answers: Sequence[_Answer]) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for answer in answers:
        for name, seconds in (answer.body.get("timings_s") or {}).items():
            if seconds is not None:
                found.setdefault(name, []).append(seconds * 1000)
    return {name: statistics.median(values) for name, values in found.items()}
