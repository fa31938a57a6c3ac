"""Kills of a node of a Ray cluster that two front doors share: Ray's processes on it, and the worker, at once; and of a front door."""

import itertools
import os
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.campaign.clients import Answers, Clients
from tests.campaign.front_doors import killed_again
from tests.campaign.outcome import Outcome
from tests.campaign.running import PATIENCE_S, tell
from tests.integration.ray_cluster import RayClusterOfOthers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

_DOORS = 2
_NODE = 1


def node_kills(times: int, num_clients: int = 4) -> Outcome:
    """Kill one of two nodes again and again; each time it is started anew, and has a worker, before the next."""
    outcome = Outcome(f"kill one of two nodes of a cluster under {num_clients} clients of {_DOORS} front doors")
    with _shared_cluster() as (cluster, doors, map_id):

        def start(_: int) -> None:
            cluster.start(_NODE)
            _wait_for_both_workers(doors)

        clients = Clients([str(door.http.base_url) for door in doors], map_id, num_clients)
        killed_again(outcome, clients, times, lambda _: cluster.kill(_NODE), start)
        outcome.figures["longest answer"] = f"{max(clients.answers.seconds):.1f} s"
    return outcome


def door_and_node_killed(num_queries: int = 200, num_clients: int = 4) -> Outcome:
    """Kill a front door after a quarter of the queries, and a node after half of them.

    A client whose connection breaks asks the other front door, as a balancer does; any other answer than 200 is a fault.
    """
    outcome = Outcome(f"kill a front door and a node during {num_queries} queries of {num_clients} clients")
    with _shared_cluster() as (cluster, doors, map_id):
        began, answers, asked_again = time.monotonic(), Answers(), itertools.count()
        kills = {
            num_queries // 4: lambda: os.kill(doors[0].process.pid, signal.SIGKILL),
            num_queries // 2: lambda: cluster.kill(_NODE),
        }
        lock = threading.Lock()

        def ask(number: int) -> None:
            asked, status, wrong = time.monotonic(), 0, False
            for each in range(_DOORS):
                try:
                    reply = doors[(number + each) % _DOORS].localize(small_room().panorama, map_id)
                except httpx.TransportError:
                    next(asked_again)
                    continue
                status = reply.status_code
                wrong = status == 200 and not small_room().error_of(reply.json()).within(0.05, 5)
                break
            with lock:
                answers.at.append(time.monotonic())
                answers.status.append(status)
                answers.seconds.append(time.monotonic() - asked)
                answers.wrong += wrong
                if kill := kills.pop(len(answers.status), None):
                    kill()

        with ThreadPoolExecutor(num_clients) as clients:
            list(clients.map(ask, range(num_queries)))
        outcome.faults += [f"the kill after {number} queries was not done" for number in kills]
        outcome.cases, outcome.seconds = len(answers.status), time.monotonic() - began
    tell(outcome, answers)
    outcome.figures |= {
        "asked again at the other front door": str(next(asked_again)),
        "longest answer": f"{max(answers.seconds):.1f} s",
    }
    return outcome


@contextmanager
def _shared_cluster() -> Iterator[tuple[RayClusterOfOthers, list[RunningService], str]]:
    """Run a cluster of two nodes, each with a worker, and its front doors, and yield them with a map."""
    redis = RealRedis()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address}
        doors = [RunningService(Path(folder) / "data", **settings) for _ in range(_DOORS)]
        try:
            for door in doors:
                door.wait_until_ready(PATIENCE_S)
            _wait_for_both_workers(doors)
            map_id = doors[0].register(small_room().scan, OPTIONS)
            # The others hear of it within half a second.
            assert eventually(lambda: all(door.map(map_id).get("status") == "ready" for door in doors), PATIENCE_S)
            yield cluster, doors, map_id
        finally:
            for door in doors:
                door.kill()
            redis.kill()


def _wait_for_both_workers(doors: list[RunningService]) -> None:
    def are_up() -> bool:
        return all(door.http.get("/health").json()["workers"]["num_workers"] == 2 for door in doors)

    assert eventually(are_up, PATIENCE_S)
