"""Two front doors over one Ray cluster of two nodes: one pool of workers for both, whatever of it dies."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from service.host.process_tree import process_name
from service.maps.record import read_record
from service.storage import open_storage
from tests.campaign.clients import Clients
from tests.integration.ray_cluster import RayClusterOfOthers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually, statuses_of_changes_at_once
from tests.integration.small_room import OPTIONS, small_room

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("redis-server") is None, reason="needs redis-server from apt"),
]
PATIENCE_S = 300.0
NODE, BOTH_NODES = 1, (0, 1)


@dataclass
class Site:
    """A cluster and its front doors; the tests of this module go through its life one after the other."""

    cluster: RayClusterOfOthers
    redis: RealRedis
    data: Path
    doors: list[RunningService] = field(default_factory=list)
    map_id: str = ""

    def open_door(self, **settings: str) -> RunningService:
        given = {"shared": "true", "redis_url": self.redis.url, "ray_address": self.cluster.address} | settings
        self.doors.append(RunningService(self.data, **given))
        return self.doors[-1]

    def workers(self, name: str = "ServeReplica", nodes: tuple[int, ...] = BOTH_NODES) -> set[int]:
        """Return Ray's workers of one kind on the cluster."""
        return {pid for node in nodes for pid in self.cluster.family(node) if name in name_of(pid)}

    def wait_for_workers(self, number: int) -> set[int]:
        assert eventually(lambda: len(self.workers()) == number, PATIENCE_S), self.workers()
        for door in self.doors:
            assert eventually(lambda door=door: num_workers(door) == number, PATIENCE_S)  # type: ignore[misc]
        return self.workers()

    def post(self, door: RunningService) -> str:
        answer = door.http.post("/maps", files={"file": ("room.ply", small_room().scan)}, data={"options": OPTIONS})
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def num_attempts(self, map_id: str) -> int:
        return read_record(open_storage(str(self.data)), map_id).newest.num_attempts


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    redis = RealRedis()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        site = Site(cluster, redis, Path(folder) / "data")
        try:
            for _ in range(2):
                site.open_door()
            for door in site.doors:
                door.wait_until_ready(PATIENCE_S)
            yield site
        finally:
            for door in site.doors:
                door.kill()
            redis.kill()


def name_of(pid: int) -> str:
    try:
        return process_name(pid)
    except OSError:
        return ""


def num_workers(door: RunningService) -> int:
    return int(door.http.get("/health").json()["workers"]["num_workers"])


def test_both_use_the_same_workers_and_see_the_same_maps(site: Site) -> None:
    first, second = site.doors
    site.map_id = first.register(small_room().scan, OPTIONS)
    assert eventually(lambda: second.map(site.map_id).get("status") == "ready", 90)
    answer = second.localize(small_room().panorama, site.map_id)
    assert answer.status_code == 200, answer.text
    assert small_room().error_of(answer.json()).within(0.05, 5)
    site.wait_for_workers(2)  # one on each node, for both together


def test_of_two_changes_at_once_one_wins_and_both_show_it(site: Site) -> None:
    first, second = site.doors
    assert statuses_of_changes_at_once(site.doors, site.map_id) == [200, 412]
    assert eventually(lambda: first.map(site.map_id) == second.map(site.map_id), 5)


def test_a_node_killed_under_queries_and_a_registration_costs_neither(site: Site) -> None:
    first, second = site.doors
    for _ in range(8):  # Ray spreads them over the nodes
        map_id = site.post(first)
        assert eventually(lambda: bool(site.workers("register_map")), PATIENCE_S)
        if site.workers("register_map", (NODE,)):
            break
        assert eventually(lambda map_id=map_id: first.map(map_id)["status"] == "ready", PATIENCE_S)  # type: ignore[misc]
    else:
        raise AssertionError("no registration came to the node")
    asking = [Clients(str(door.http.base_url), site.map_id, 2) for door in (first, second)]
    # While the registration runs; it takes seconds to load what it needs.
    site.cluster.kill(NODE)
    killed = time.monotonic()
    try:
        for clients in asking:
            assert eventually(lambda clients=clients: clients.answered_since(killed), PATIENCE_S)  # type: ignore[misc]
        assert eventually(lambda: first.map(map_id)["status"] in ("ready", "failed"), PATIENCE_S)
    finally:
        answers = [clients.stop() for clients in asking]
    assert [set(each.status) for each in answers] == [{200}, {200}]
    assert [each.wrong for each in answers] == [0, 0]
    assert first.map(map_id)["status"] == "ready", first.map(map_id)
    assert site.num_attempts(map_id) == 2


def test_a_node_that_is_there_again_gets_a_worker(site: Site) -> None:
    site.cluster.start(NODE)
    site.wait_for_workers(2)


def test_a_front_door_that_is_killed_takes_nothing_from_the_other_and_comes_back_to_the_same_workers(
    site: Site,
) -> None:
    first, second = site.doors
    before = site.workers()
    clients = Clients(str(second.http.base_url), site.map_id, 2)
    try:
        assert eventually(lambda: clients.answered_since(0.0), PATIENCE_S)
        map_id = site.post(first)
        assert eventually(lambda: second.map(map_id)["status"] in ("reading", "indexing"), PATIENCE_S)
        os.kill(first.process.pid, signal.SIGKILL)  # it has brought the workers up
        first.process.wait()
        killed = time.monotonic()
        assert eventually(lambda: clients.answered_since(killed + 0.5), PATIENCE_S)
        assert eventually(lambda: second.map(map_id)["status"] in ("ready", "failed"), PATIENCE_S)
    finally:
        answers = clients.stop()
    assert set(answers.status) == {200}
    # What the killed one was registering, the other has taken over.
    assert second.map(map_id)["status"] == "ready", second.map(map_id)
    assert site.num_attempts(map_id) == 2
    first.kill()
    site.doors = [second]
    third = site.open_door()
    third.wait_until_ready(PATIENCE_S)
    assert third.localize(small_room().panorama, site.map_id).status_code == 200
    assert site.workers() == before


def test_one_with_another_configuration_has_workers_of_its_own_and_says_so(site: Site) -> None:
    before = site.workers()
    other = site.open_door(resident_bytes="1000000000")
    other.wait_until_ready(PATIENCE_S)
    assert "resident_bytes 2147483648 instead of 1000000000" in other.log
    assert other.localize(small_room().panorama, site.map_id).status_code == 200
    assert before < site.workers()
    assert other.stop() == 0
    site.doors.remove(other)
    assert eventually(lambda: site.workers() == before, PATIENCE_S)


def test_a_head_that_is_killed_is_missed_and_joined_again_without_a_restart(site: Site) -> None:
    pids = [door.process.pid for door in site.doors]
    for number in reversed(BOTH_NODES):
        site.cluster.kill(number)
    for door in site.doors:
        assert eventually(lambda door=door: door.status("/health/ready") == 503, PATIENCE_S)  # type: ignore[misc]
        assert door.status("/health/live") == 200
        refused = door.localize(small_room().panorama, site.map_id)
        assert refused.status_code == 503, refused.text
        assert int(refused.headers["Retry-After"]) >= 1
    site.cluster.start(0)
    for door in site.doors:
        door.wait_until_ready(PATIENCE_S)
        assert door.localize(small_room().panorama, site.map_id).status_code == 200
    assert [door.process.pid for door in site.doors] == pids
    assert len(site.workers(nodes=(0,))) == 1


def test_a_machine_that_joins_later_gets_a_worker_too_and_the_others_keep_theirs(site: Site) -> None:
    before = site.workers(nodes=(0,))
    site.cluster.start(NODE)
    assert site.wait_for_workers(2) > before


def test_the_last_ones_to_leave_take_the_workers_away_also_when_they_leave_together(site: Site) -> None:
    for door in site.doors:
        door.process.send_signal(signal.SIGTERM)
    for door in site.doors:
        assert door.process.wait(PATIENCE_S) == 0
    assert eventually(lambda: not site.workers(), PATIENCE_S)
