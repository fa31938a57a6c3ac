"""Changes of one map that meet each other: whatever their order, nothing is lost and nothing half-written stays."""

import asyncio

import pytest

from tests.service.api.held_call import HeldCall, long_enough
from tests.service.api.running_service import RunningService

pytestmark = pytest.mark.anyio


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
