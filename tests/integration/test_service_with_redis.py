"""The service with a Redis of its operator's: what happens when a worker or Redis is killed."""

import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import kill
from pathlib import Path

import pytest
import redis

from panoloc.lab.process_memory import family_bytes
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually, is_running
from tests.integration.small_room import OPTIONS, small_room

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("redis-server") is None, reason="needs redis-server from apt"),
]


@dataclass
class Running:
    service: RunningService
    redis: RealRedis
    map_id: str


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    server = RealRedis()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service = RunningService(Path(folder) / "data", redis_url=server.url)
        try:
            service.wait_until_ready()
            yield Running(service, server, service.register(small_room().scan, OPTIONS))
        finally:
            service.stop()
            server.kill()


def test_a_panorama_is_localized_where_it_was_taken(running: Running) -> None:
    answer = running.service.localize(small_room().panorama, running.map_id)
    assert answer.status_code == 200, answer.text
    assert answer.json()["status"] == "localized"
    assert small_room().error_of(answer.json()).within(0.05, 5)


def test_the_worker_has_not_loaded_what_reads_scans(running: Running) -> None:
    mapped = Path(f"/proc/{running.service.worker_pid()}/maps").read_text()
    assert "torch" in mapped
    assert "open3d" not in mapped


def test_after_many_queries_all_processes_together_hold_what_they_held_before(running: Running) -> None:
    def idle_bytes() -> int:
        time.sleep(3)
        return sum(family_bytes(running.service.process.pid).values())

    before = idle_bytes()
    for _ in range(12):
        assert running.service.localize(small_room().panorama, running.map_id).status_code == 200
    assert idle_bytes() < 1.1 * before


def test_a_worker_killed_under_eight_requests_costs_no_answer(running: Running) -> None:
    killed = running.service.worker_pid()
    with ThreadPoolExecutor(8) as clients:
        requests = [clients.submit(running.service.localize, small_room().panorama, running.map_id) for _ in range(8)]
        running.service.wait_until_taken(requests)
        kill(killed, signal.SIGKILL)
        answers = [request.result() for request in requests]
    assert [answer.status_code for answer in answers] == [200] * 8
    assert all(small_room().error_of(answer.json()).within(0.05, 5) for answer in answers)
    assert not is_running(killed)


def test_losing_every_key_of_redis_loses_no_map_and_no_request(running: Running) -> None:
    redis.Redis.from_url(running.redis.url).flushall()
    kill(running.service.worker_pid(), signal.SIGKILL)  # so that the index is in no memory either
    answer = running.service.localize(small_room().panorama, running.map_id)
    assert answer.status_code == 200, answer.text
    assert small_room().error_of(answer.json()).within(0.05, 5)
    assert [each["id"] for each in running.service.http.get("/maps").json()["items"]] == [running.map_id]


def test_while_redis_is_away_callers_are_told_when_to_return_and_afterwards_all_is_well(running: Running) -> None:
    running.redis.kill()
    answer = running.service.localize(small_room().panorama, running.map_id)
    ready = running.service.status("/health/ready")
    running.redis.start()
    assert answer.status_code == 503, answer.text
    assert int(answer.headers["Retry-After"]) >= 1
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert ready == 503
    assert running.service.status("/health/live") == 200
    assert eventually(lambda: running.service.status("/health/ready") == 200, 90)
    assert running.service.localize(small_room().panorama, running.map_id).status_code == 200
    assert running.service.map(running.map_id)["status"] == "ready"
