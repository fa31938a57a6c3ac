"""Two API replicas whose workers are on a Ray cluster of two nodes, whatever of it dies."""

import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from panoloc.lab.process_memory import command_of
from panoloc.service.maps.record import read_record
from panoloc.service.storage import open_storage
from tests.campaign.clients import Clients
from tests.integration.ray_cluster import RayClusterOfOthers, start_workers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("redis-server") is None, reason="needs redis-server from apt"),
]
TIMEOUT_S = 300.0
NODE, BOTH_NODES = 1, (0, 1)


@dataclass
class Site:
    """A cluster and its API replicas; the tests of this module go through its life one after the other."""

    cluster: RayClusterOfOthers
    redis: RealRedis
    data: Path
    replicas: list[RunningService]
    map_id: str = ""

    def start_workers(self) -> None:
        start_workers(self.cluster.address, self.data, self.redis.url)

    def post(self) -> str:
        answer = self.replicas[0].http.post(
            "/maps", files={"file": ("room.ply", small_room().scan)}, data={"options": OPTIONS}
        )
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def nodes_that_register(self) -> list[int]:
        return [
            node for node in BOTH_NODES for pid in self.cluster.family(node) if command_of(pid) == "panoloc-builder"
        ]


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    with RealRedis() as redis, tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        data = Path(folder) / "data"
        start_workers(cluster.address, data, redis.url)
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address}
        site = Site(cluster, redis, data, [RunningService(data, **settings) for _ in range(2)])
        try:
            for replica in site.replicas:
                replica.wait_until_ready(TIMEOUT_S)
            yield site
        finally:
            for replica in site.replicas:
                replica.kill()


def test_both_use_the_same_two_workers_and_see_the_same_maps(site: Site) -> None:
    first, second = site.replicas
    site.map_id = first.register(small_room().scan, OPTIONS)
    assert eventually(lambda: second.map(site.map_id).get("status") == "ready", 90)
    for replica in site.replicas:
        answer = replica.localize(small_room().panorama, site.map_id)
        assert answer.status_code == 200, answer.text
        assert small_room().error_of(answer.json()).within(0.05, 5)
        assert replica.http.get("/health").json()["workers"]["num_workers"] == 2


def test_a_node_killed_under_queries_and_a_registration_costs_neither(site: Site) -> None:
    first = site.replicas[0]
    for _ in range(8):  # Ray spreads them over the nodes
        map_id = site.post()
        assert eventually(lambda: bool(site.nodes_that_register()), TIMEOUT_S)
        if NODE in site.nodes_that_register():
            break
        first.http.delete(f"/maps/{map_id}")
        assert eventually(lambda: not site.nodes_that_register(), TIMEOUT_S)
    else:
        raise AssertionError("no registration came to the node")
    asking = [Clients(str(replica.http.base_url), site.map_id, 2) for replica in site.replicas]
    site.cluster.kill(NODE)
    killed = time.monotonic()
    try:
        for clients in asking:
            assert eventually(lambda clients=clients: clients.answered_since(killed), TIMEOUT_S)  # type: ignore[misc]
    finally:
        answers = [clients.stop() for clients in asking]
    assert eventually(lambda: first.map(map_id)["status"] in ("ready", "failed"), TIMEOUT_S)
    assert [set(each.status) for each in answers] == [{200}, {200}]
    assert [each.wrong for each in answers] == [0, 0]
    assert first.map(map_id)["status"] == "ready", first.map(map_id)
    assert read_record(open_storage(str(site.data)), map_id).newest.num_attempts == 2


def test_a_replica_with_another_redis_than_the_workers_says_so_and_takes_no_query(site: Site) -> None:
    with RealRedis() as other:
        replica = RunningService(site.data, shared="true", redis_url=other.url, ray_address=site.cluster.address)
        try:
            assert eventually(lambda: "PANOLOC_REDIS_URL" in replica.log, TIMEOUT_S)
            assert replica.status("/health/ready") == 503
        finally:
            replica.kill()


def test_a_head_that_is_killed_is_missed_and_its_successor_is_used_without_a_restart(site: Site) -> None:
    pids = [replica.process.pid for replica in site.replicas]
    site.cluster.kill(0)
    for replica in site.replicas:
        assert eventually(lambda replica=replica: replica.status("/health/ready") == 503, TIMEOUT_S)  # type: ignore[misc]
        assert replica.status("/health/live") == 200
        refused = replica.localize(small_room().panorama, site.map_id)
        assert refused.status_code == 503, refused.text
        assert int(refused.headers["Retry-After"]) >= 1
    site.cluster.start(0)
    site.start_workers()
    for replica in site.replicas:
        replica.wait_until_ready(TIMEOUT_S)
        assert replica.localize(small_room().panorama, site.map_id).status_code == 200
    assert [replica.process.pid for replica in site.replicas] == pids
