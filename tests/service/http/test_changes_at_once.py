"""Changes of one map that meet each other: whatever their order, nothing is lost and nothing half-written stays."""

import asyncio

import pytest
import redis

from tests.service.http.held_call import HeldCall, long_enough
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio


@pytest.mark.slow
async def test_a_registration_ended_by_several_is_waited_for_by_each(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    registrations = running.app.state.services.registrations
    writing = HeldCall(monkeypatch, running.storage, "put", "/preview.png")
    map_id = (await running.upload()).json()["id"]
    await writing.begun()
    enders = []
    for _ in range(3):
        enders.append(asyncio.create_task(registrations.cancel(map_id)))
        await long_enough()
    assert not any(ender.done() for ender in enders)
    writing.let_go()
    await asyncio.gather(*enders)
    assert running.storage.names(f"maps/{map_id}/1") == ["points.ply", "preview.png", "scan.ply", "starts.json"]


async def test_a_registration_that_several_end_is_counted_once(running: RunningService) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    await running.eventually(f"/maps/{map_id}", lambda body: body["status"] == "indexing")
    registrations = running.app.state.services.registrations
    await asyncio.gather(registrations.cancel(map_id), registrations.cancel(map_id))
    metrics = (await running.client.get("/metrics")).text
    assert 'panoloc_registrations_total{result="cancelled"} 1.0' in metrics


async def test_a_scan_replaced_when_it_is_almost_a_map_leaves_neither_files_nor_an_index(
    running: RunningService, monkeypatch: pytest.MonkeyPatch, redis_client: "redis.Redis"
) -> None:
    map_id = await running.ready_map()
    writing = HeldCall(monkeypatch, running.storage, "put", "/2/points.ply")
    await running.replace_scan(map_id)
    await writing.begun()
    putting = asyncio.create_task(running.replace_scan(map_id))
    await long_enough()
    writing.let_go()
    assert (await putting).status_code == 202
    await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 3)
    await running.eventually("/health", lambda _: running.storage.names(f"maps/{map_id}") == ["3", "map.json"])
    await running.eventually("/health", lambda _: len(redis_client.keys("index:*")) == 1)


async def test_a_map_deleted_while_a_new_scan_is_stored_is_gone(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    map_id = await running.ready_map()
    storing = HeldCall(monkeypatch, running.storage, "adopt", "/2/scan.ply")
    putting = asyncio.create_task(running.replace_scan(map_id))
    await storing.begun()
    deleting = asyncio.create_task(running.client.delete(f"/maps/{map_id}"))
    await long_enough()
    storing.let_go()
    assert (await deleting).status_code == 204
    assert (await putting).status_code == 404
    assert running.storage.names("maps") == []


@pytest.mark.slow
async def test_a_scan_that_comes_while_a_deletion_ends_a_registration_leaves_nothing(
    running: RunningService, monkeypatch: pytest.MonkeyPatch, redis_client: "redis.Redis"
) -> None:
    map_id = await running.ready_map()
    running.pool.register_gate.clear()
    await running.replace_scan(map_id)
    await running.eventually(f"/maps/{map_id}", lambda body: body["status"] == "indexing")
    running.pool.end_gate.clear()
    removing = HeldCall(monkeypatch, running.storage, "delete_all", map_id)
    deleting = asyncio.create_task(running.client.delete(f"/maps/{map_id}"))
    await long_enough()
    putting = asyncio.create_task(running.replace_scan(map_id))
    await long_enough()
    running.pool.end_gate.set()
    await long_enough()
    removing.let_go()
    assert (await deleting).status_code == 204
    running.pool.register_gate.set()
    await putting
    await long_enough()
    assert running.storage.names("maps") == []
    assert redis_client.keys("*") == []


async def test_viewers_get_the_new_picture_when_the_old_one_goes_while_they_ask(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    map_id = await running.ready_map()
    reading = HeldCall(monkeypatch, running.storage, "read", "/1/preview.png")
    asking = asyncio.create_task(running.client.get(f"/maps/{map_id}/preview.png"))
    await reading.begun()
    await running.replace_scan(map_id)
    await running.eventually("/health", lambda _: running.storage.names(f"maps/{map_id}") == ["2", "map.json"])
    reading.let_go()
    reply = await asking
    assert (reply.status_code, reply.headers["etag"]) == (200, f'W/"{map_id}-2"')


async def test_viewers_are_told_when_the_map_is_deleted_while_they_ask(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    map_id = await running.ready_map()
    reading = HeldCall(monkeypatch, running.storage, "read", "/1/preview.png")
    asking = asyncio.create_task(running.client.get(f"/maps/{map_id}/preview.png"))
    await reading.begun()
    await running.client.delete(f"/maps/{map_id}")
    reading.let_go()
    assert (await asking).status_code == 404


async def test_an_answer_that_comes_after_its_map_was_deleted_is_not_kept(
    running: RunningService, redis_client: "redis.Redis"
) -> None:
    map_id = await running.ready_map()
    asking = await running.held_query(map_id, options='{"artifacts": ["overlay"]}')
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    running.pool.localize_gate.set()
    await asking
    assert redis_client.keys("*") == []
