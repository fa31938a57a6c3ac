"""The service with a Redis of its operator's: what it holds, and what happens when a worker or Redis is killed.

As the last of this folder, so that the others see a service to which nothing has happened.
"""

import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from os import kill
from pathlib import Path

import pytest
import redis

from panoloc.lab.process_memory import family_bytes
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually, is_running
from tests.integration.small_room import small_room

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("redis-server") is None, reason="needs redis-server from apt"),
]


def test_a_panorama_is_localized_where_it_was_taken(service: RunningService, map_id: str) -> None:
    answer = service.localize(small_room().panorama, map_id)
    assert answer.status_code == 200, answer.text
    assert answer.json()["status"] == "localized"
    assert small_room().error_of(answer.json()).within(0.05, 5)


def test_the_worker_has_not_loaded_what_reads_scans(service: RunningService) -> None:
    mapped = Path(f"/proc/{service.worker_pid()}/maps").read_text()
    assert "torch" in mapped
    assert "open3d" not in mapped


def test_after_many_queries_all_processes_together_hold_what_they_held_before(
    service: RunningService, map_id: str
) -> None:
    def idle_bytes() -> int:
        time.sleep(2)  # it gives back what it freed
        return sum(family_bytes(service.process.pid).values())

    before = idle_bytes()
    for _ in range(12):
        assert service.localize(small_room().panorama, map_id).status_code == 200
    assert idle_bytes() < 1.1 * before


def test_a_worker_killed_under_eight_requests_costs_no_answer(service: RunningService, map_id: str) -> None:
    killed = service.worker_pid()
    with ThreadPoolExecutor(8) as clients:
        requests = [clients.submit(service.localize, small_room().panorama, map_id) for _ in range(8)]
        service.wait_until_taken(requests)
        kill(killed, signal.SIGKILL)
        answers = [request.result() for request in requests]
    assert [answer.status_code for answer in answers] == [200] * 8
    assert all(small_room().error_of(answer.json()).within(0.05, 5) for answer in answers)
    assert not is_running(killed)


def test_losing_every_key_of_redis_loses_no_map_and_no_request(
    service: RunningService, own_redis: RealRedis, map_id: str
) -> None:
    redis.Redis.from_url(own_redis.url).flushall()
    kill(service.worker_pid(), signal.SIGKILL)  # so that the index is in no memory either
    answer = service.localize(small_room().panorama, map_id)
    assert answer.status_code == 200, answer.text
    assert small_room().error_of(answer.json()).within(0.05, 5)
    assert map_id in [each["id"] for each in service.http.get("/maps").json()["items"]]


def test_while_redis_is_away_callers_are_told_when_to_return_and_afterwards_all_is_well(
    service: RunningService, own_redis: RealRedis, map_id: str
) -> None:
    own_redis.kill()
    answer = service.localize(small_room().panorama, map_id)
    ready = service.status("/health/ready")
    own_redis.start()
    assert answer.status_code == 503, answer.text
    assert int(answer.headers["Retry-After"]) >= 1
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert ready == 503
    assert service.status("/health/live") == 200
    assert eventually(lambda: service.status("/health/ready") == 200, 90)
    assert service.localize(small_room().panorama, map_id).status_code == 200
    assert service.map(map_id)["status"] == "ready"
