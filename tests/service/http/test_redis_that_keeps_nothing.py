"""A Redis that is full or read-only answers, but keeps nothing: callers who wait get their answer, readiness says so."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import redis

from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio

STATES = ["full", "read-only"]


@pytest.fixture
def keep_nothing(redis_client: "redis.Redis") -> Iterator[Callable[[str], None]]:
    """Bring Redis into one of STATES until the end of the test."""
    before: dict[Any, Any] = redis_client.config_get("maxmemory", "maxmemory-policy")

    def enter(state: str) -> None:
        if state == "full":
            redis_client.config_set("maxmemory-policy", "noeviction")
            redis_client.config_set("maxmemory", 1)
        else:
            redis_client.replicaof("127.0.0.1", "1")

    yield enter
    redis_client.replicaof("NO", "ONE")
    for name, value in before.items():
        redis_client.config_set(name, value)


@pytest.mark.parametrize("state", STATES)
async def test_only_callers_who_wait_get_an_answer_and_readiness_tries_a_write(
    running: RunningService, keep_nothing: Callable[[str], None], state: str
) -> None:
    map_id = await running.ready_map()
    assert await running.status("GET", "/health/ready") == 200
    keep_nothing(state)
    reply = await running.client.get("/health/ready")
    assert (reply.status_code, reply.json()["waiting_for"]) == (503, ["Redis"])
    reply = await running.localize(map_id, headers={"Prefer": "respond-async"})
    assert (reply.status_code, reply.json()["type"]) == (503, "/problems/cache-down")
    assert running.pool.jobs == []
    reply = await running.localize(map_id, options='{"artifacts": ["overlay"]}')
    assert reply.status_code == 200
    body: dict[str, Any] = reply.json()
    assert body["status"] == "localized"
    assert "Redis cannot store this answer" in body["warnings"][-1]
    assert body["artifacts"] == {}
