"""How often the HTTP process waits for Redis: what is sent together is one round trip, however many commands it holds."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import redis
from redis.asyncio.connection import AbstractConnection

from service.jobs import ARTIFACTS
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio

EVERY_PICTURE = json.dumps({"artifacts": ARTIFACTS})


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Return what the connections of the HTTP process send from now on, one entry for each time that they wait for an answer."""
    found: list[bytes] = []
    send = AbstractConnection.send_packed_command

    async def noting(connection: AbstractConnection, command: Any, *arguments: Any, **options: Any) -> None:
        found.append(command if isinstance(command, bytes) else b"".join(command))
        await send(connection, command, *arguments, **options)

    monkeypatch.setattr(AbstractConnection, "send_packed_command", noting)
    return found


@contextmanager
def at_most(sent: list[bytes], num_round_trips: int) -> Iterator[None]:
    """Hold the block to this many round trips."""
    before = len(sent)
    yield
    commands = [each[:60] for each in sent[before:]]
    assert 0 < len(commands) <= num_round_trips, commands


async def test_a_query_asks_redis_whether_it_is_there_and_keeps_answer_and_pictures_at_once(
    running: RunningService, sent: list[bytes]
) -> None:
    map_id = await running.ready_map()
    with at_most(sent, 2):
        assert (await running.localize(map_id, options=EVERY_PICTURE)).status_code == 200


async def test_a_query_whose_answer_is_fetched_later_notes_its_state_once_and_its_answer_once(
    running: RunningService, sent: list[bytes]
) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    with at_most(sent, 2):
        reply = await running.localize(map_id, options=EVERY_PICTURE, headers={"Prefer": "respond-async"})
        running.pool.localize_gate.set()
        await running.app.state.services.localizations.stop(drain_s=3)
    body = (await running.client.get(reply.headers["location"])).json()
    assert body["status"] == "localized"


@pytest.mark.parametrize("num_answers", [1, 20])
async def test_deleting_a_map_takes_as_many_round_trips_however_many_answers_there_were(
    running: RunningService, redis_client: "redis.Redis", sent: list[bytes], num_answers: int
) -> None:
    map_id = await running.ready_map()
    for _ in range(num_answers):
        await running.localize(map_id, options=EVERY_PICTURE)
    with at_most(sent, 4):
        assert (await running.client.delete(f"/maps/{map_id}")).status_code == 204
    assert redis_client.keys("*") == []
