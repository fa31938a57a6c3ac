"""How long queries of several cameras take over HTTP, sent in turn, so that whatever else the machine does meets them alike."""

import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.geometry.pose import Pose, pose_error
from lab.benchmark.service.camera_queries import CAMERAS, CameraQuery, camera_queries
from lab.benchmark.timing import Say, Spread, spread_of
from service.client import JsonObject, PanolocClient

_RIGHT = 0.3, 10.0  # metres and degrees


@dataclass(frozen=True)
class CameraFigures:
    """What the queries of one camera took. right: within 0.3 m and 10 degrees. ratio: of the median to that of panoramas."""

    camera: str
    images: int
    queries: int
    localized: int
    right: int
    latency: Spread
    ratio: float


def measure_cameras(
    client: PanolocClient, width: int, num_rooms: int, points: int, repeats: int, say: Say
) -> list[dict[str, Any]]:
    """Return the figures of each camera in furnished rooms of which 60 % has changed; each room's queries are sent `repeats` times.

    Raises a ClientError when the service refuses a scan or a query.
    """
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        queries = camera_queries(client, Path(folder), width, num_rooms, points, say)
        try:
            say("warming up")
            for query in queries:
                _sent(client, query)
            taken = [(query, *_sent(client, query)) for query in _in_turn(queries, repeats, say)]
        finally:
            for map_id in {query.map_id for query in queries}:
                client.delete_map(map_id)
    times = {name: spread_of([ms for query, ms, _ in taken if query.camera == name]) for name in CAMERAS}
    found = []
    for name in CAMERAS:
        answers = [(query, body) for query, _, body in taken if query.camera == name]
        found.append(
            CameraFigures(
                name,
                len(answers[0][0].images),
                len(answers),
                sum(body["status"] == "localized" for _, body in answers),
                sum(_is_right(body, query.pose) for query, body in answers),
                times[name],
                times[name].median_ms / times["panorama"].median_ms,
            )
        )
    return [asdict(figures) for figures in found]


def _in_turn(queries: Sequence[CameraQuery], repeats: int, say: Say) -> Iterable[CameraQuery]:
    for number in range(repeats):
        say(f"queries of every camera, round {number + 1} of {repeats}")
        yield from queries


def _sent(client: PanolocClient, query: CameraQuery) -> tuple[float, JsonObject]:
    """Return the milliseconds from sending the first byte to the end of the answer, and the answer."""
    began = time.perf_counter()
    body = client.localize(query.images, [query.map_id], options=query.options)
    return (time.perf_counter() - began) * 1000, body


def _is_right(body: JsonObject, truth: Pose) -> bool:
    poses = [body["pose"], *(other["pose"] for other in body["alternatives"])]
    best = next((pose for pose in poses if pose is not None), None)
    if best is None:
        return False
    matrix = np.asarray(best["map_from_camera"]["matrix"], np.float64)
    return pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), truth).within(*_RIGHT)
