"""Sends queries to a service from several clients at the same time, and measures what each waited."""

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from panoloc.core.geometry.pose import Pose, PoseError, pose_error
from panoloc.lab.benchmark.timing import Spread, spread_of
from panoloc.service.cli.session import Session
from panoloc.service.client import ClientError, JsonObject


@dataclass(frozen=True, eq=False)
class KnownQuery:
    """A query: its images, its options as `POST /localize` takes them, the map, and map_from_camera of the first image."""

    images: tuple[Path, ...]
    map_id: str
    pose: Pose
    options: JsonObject


@dataclass(frozen=True)
class Answer:
    """One answer, and the milliseconds from sending the first byte to the end of the answer."""

    milliseconds: float
    body: JsonObject
    query: KnownQuery

    @property
    def is_localized(self) -> bool:
        """Return whether the service is sure of its pose."""
        return bool(self.body["status"] == "localized")

    @property
    def error(self) -> PoseError | None:
        """Return how far off the best pose is, localized or not; None without one."""
        poses = [self.body["pose"], *(other["pose"] for other in self.body["alternatives"])]
        best = next((pose for pose in poses if pose is not None), None)
        if best is None:
            return None
        matrix = np.asarray(best["map_from_camera"]["matrix"], np.float64)
        return pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), self.query.pose)


@dataclass(frozen=True)
class LoadFigures:
    """What `clients` at the same time got, all figures of the answers that came.

    failed: queries that got no answer; last_error says why. max_position_error_m: None when no answer had a pose.
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


def load_figures(
    session: Session, url: str, queries: Sequence[KnownQuery], clients: int, method: str = "fast"
) -> LoadFigures:
    """Send all queries and return what the clients got. Raises the last ClientError when no query is answered at all."""
    began = time.perf_counter()
    answers, errors = send_queries(session, url, queries, clients)
    wall_s = time.perf_counter() - began
    if not answers:
        raise errors[-1]
    off = [answer.error.position_m for answer in answers if answer.error is not None]
    return LoadFigures(
        method=method,
        clients=clients,
        queries=len(queries),
        failed=len(errors),
        localized=sum(answer.is_localized for answer in answers),
        max_position_error_m=max(off, default=None),
        latency=spread_of([answer.milliseconds for answer in answers]),
        throughput_per_s=len(answers) / wall_s,
        service_stages_ms=_stage_medians(answers),
        last_error=str(errors[-1]) if errors else None,
    )


def send_queries(
    session: Session, url: str, queries: Sequence[KnownQuery], clients: int
) -> tuple[list[Answer], list[ClientError]]:
    """Send all queries, each client the next one as soon as its last was answered; return answers and errors."""
    waiting = iter(queries)
    with ThreadPoolExecutor(clients) as threads:
        running = [threads.submit(_one_client, session, url, waiting) for _ in range(clients)]
        try:
            results = [result for thread in running for result in thread.result()]
        finally:
            for _ in waiting:  # an interruption does not wait for the queries that are left
                pass
    answers = [result for result in results if isinstance(result, Answer)]
    return answers, [result for result in results if isinstance(result, ClientError)]


def _one_client(session: Session, url: str, waiting: Iterator[KnownQuery]) -> list[Answer | ClientError]:
    """Send what is waiting, which all clients share."""
    found: list[Answer | ClientError] = []
    with session.client(url) as client:
        for query in waiting:
            began = time.perf_counter()
            try:
                body = client.localize(query.images, [query.map_id], options=query.options)
            except ClientError as error:
                found.append(error)
            else:
                found.append(Answer((time.perf_counter() - began) * 1000, body, query))
    return found


def _stage_medians(answers: Sequence[Answer]) -> dict[str, float]:
    """Return the median milliseconds of each stage that any answer names."""
    timings = [answer.body.get("timings_s") or {} for answer in answers]
    names = dict.fromkeys(name for one in timings for name in one)
    found = {name: [one[name] for one in timings if one.get(name) is not None] for name in names}
    return {name: 1000 * statistics.median(seconds) for name, seconds in found.items() if seconds}
