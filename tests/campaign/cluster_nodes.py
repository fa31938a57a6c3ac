"""Kills of a node of a Ray cluster that two front doors share: Ray's processes on it, and the worker, at once."""

import tempfile
from pathlib import Path

from tests.campaign.clients import Clients
from tests.campaign.front_doors import killed_again
from tests.campaign.outcome import Outcome
from tests.campaign.running import PATIENCE_S
from tests.integration.ray_cluster import RayClusterOfOthers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

_DOORS = 2
_NODE = 1


def node_kills(times: int, num_clients: int = 4) -> Outcome:
    """Kill one of two nodes again and again; each time it is started anew, and has a worker, before the next."""
    outcome = Outcome(f"kill one of two nodes of a cluster under {num_clients} clients of {_DOORS} front doors")
    redis = RealRedis()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address}
        doors = [RunningService(Path(folder) / "data", **settings) for _ in range(_DOORS)]

        def start(_: int) -> None:
            cluster.start(_NODE)
            _wait_for_both_workers(doors)

        try:
            for door in doors:
                door.wait_until_ready(PATIENCE_S)
            _wait_for_both_workers(doors)
            map_id = doors[0].register(small_room().scan, OPTIONS)
            clients = Clients([str(door.http.base_url) for door in doors], map_id, num_clients)
            killed_again(outcome, clients, times, lambda _: cluster.kill(_NODE), start)
            outcome.figures["longest answer"] = f"{max(clients.answers.seconds):.1f} s"
        finally:
            for door in doors:
                door.kill()
            redis.kill()
    return outcome


def _wait_for_both_workers(doors: list[RunningService]) -> None:
    def are_up() -> bool:
        return all(door.http.get("/health").json()["workers"]["num_workers"] == 2 for door in doors)

    assert eventually(are_up, PATIENCE_S)
