"""Damaged requests, sent over sockets to the application: no status of the 500s but 503 and 504, and it answers afterwards."""

import json
import random
import socket
import tempfile
import time
from collections import Counter
from pathlib import Path
from unittest import mock
from urllib.parse import urlsplit

import httpx

from panoloc.service.http import server
from panoloc.service.http.guards import slow_clients
from tests.campaign.damage import damaged
from tests.campaign.outcome import Outcome, quantile
from tests.service.http.running_service import SCAN, listening, png_of
from tests.service.started_redis import started_redis

_LONGEST_S = 10.0


def hostile_requests(num_cases: int, seed: int) -> Outcome:
    """Send damaged requests one after the other, each on a connection of its own."""
    outcome, began = Outcome("hostile requests"), time.monotonic()
    statuses: Counter[str] = Counter()
    lasted: list[float] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        started_redis() as redis,
        mock.patch.object(server, "_HEAD_TIMEOUT_S", 0.5),
        mock.patch.object(slow_clients, "TIMEOUT_S", 0.5),
        listening(Path(folder), redis.url) as url,
    ):
        seeds = _seeds(url)
        for number in range(num_cases):
            chance = random.Random(f"{seed}-{number}")
            asked = time.monotonic()
            status = _sent(url, damaged(seeds[number % len(seeds)], chance))
            lasted.append(time.monotonic() - asked)
            statuses[status[:1] + "xx" if status else "closed"] += 1
            outcome.cases += 1
            if status.startswith("5") and status not in ("503", "504"):
                outcome.faults.append(f"case {number}: {status}")
        if httpx.get(f"{url}/health/ready").status_code != 200:
            outcome.faults.append("it is not ready afterwards")
    if max(lasted, default=0.0) > _LONGEST_S:
        outcome.faults.append(f"one request took {max(lasted):.0f} s")
    outcome.seconds = time.monotonic() - began
    outcome.figures = {name: f"{count:,}" for name, count in sorted(statuses.items())}
    outcome.figures["p99"] = f"{1000 * quantile(lasted, 0.99):.0f} ms"
    return outcome


def _seeds(url: str) -> list[bytes]:
    with httpx.Client(base_url=url) as client:
        made = client.post("/maps", files={"file": ("office.ply", SCAN)})
        map_id = made.json()["id"]
        options = json.dumps({"frame": "webxr", "hints": {"position_m": [1, 2, 3], "radius_m": 5}, "top_k": 3})
        requests = [
            client.build_request("GET", f"/maps?limit=3&tag=x&cursor={map_id}"),
            client.build_request("GET", f"/maps/{map_id}/points?max_points=7"),
            client.build_request(
                "PATCH", f"/maps/{map_id}", json={"name": "hall", "tags": ["a"], "shared_with": ["b"]}
            ),
            client.build_request("POST", "/maps", files={"file": ("a.ply", SCAN)}, data={"options": '{"unit": "mm"}'}),
            client.build_request(
                "POST",
                "/localize",
                files={"image": ("a.png", png_of(8, 4))},
                data={"map_id": map_id, "options": options},
            ),
            client.build_request("POST", "/batches", files={"image": ("a.png", png_of(8, 4))}, data={"map_id": map_id}),
            client.build_request("POST", "/geopose", json={"id": "1", "sensorReadings": {"cameraReadings": []}}),
        ]
    return [_bytes_of(request) for request in requests]


def _bytes_of(request: httpx.Request) -> bytes:
    head = [
        f"{request.method} {request.url.raw_path.decode()} HTTP/1.1",
        *(f"{name}: {value}" for name, value in request.headers.items()),
    ]
    return ("\r\n".join([*head, "connection: close"]) + "\r\n\r\n").encode() + request.read()


def _sent(url: str, data: bytes) -> str:
    """Return the status, an empty text where the connection was closed without one."""
    place = urlsplit(url)
    try:
        with socket.create_connection((place.hostname or "", place.port or 80), _LONGEST_S) as client:
            client.sendall(data)
            answer = client.recv(65536)
    except OSError:
        return ""
    words = answer.split(b" ", 2)
    return words[1].decode(errors="replace") if len(words) > 2 and words[0].startswith(b"HTTP/") else ""
