"""A disk that is full, or a data folder that has become read-only: nothing is lost, everybody is told, and it goes on by itself."""

import asyncio
import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from panoloc.service.maps.registrations import Registrations
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio

LACKS = [(errno.ENOSPC, "storage-full", "room on the disk"), (errno.EROFS, "storage-read-only", "can be written")]


@pytest.fixture
def refuse_writes(monkeypatch: pytest.MonkeyPatch) -> Callable[[int | None], None]:
    """Let every file that is opened to be written fail with a number of `errno`, until told None."""
    state: list[int | None] = [None]
    really_open = Path.open

    def open_file(path: Path, mode: str = "r", *rest: object, **named: object) -> object:
        if state[0] is not None and mode.startswith("w"):
            raise OSError(state[0], os.strerror(state[0]))
        return really_open(path, mode, *rest, **named)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", open_file)
    monkeypatch.setattr("panoloc.service.maps.registrations._ROOM_PAUSE_S", 0.02)

    def refuse(number: int | None) -> None:
        state[0] = number

    return refuse


@pytest.mark.parametrize(("number", "slug", "missing"), LACKS)
async def test_changes_and_uploads_are_503_and_readiness_says_what_is_missing(
    running: RunningService, refuse_writes: Callable[[int | None], None], number: int, slug: str, missing: str
) -> None:
    map_id = await running.ready_map()
    refuse_writes(number)
    for reply in (await running.client.patch(f"/maps/{map_id}", json={"name": "new"}), await running.upload()):
        assert (reply.status_code, reply.json()["type"]) == (503, f"/problems/{slug}")
        assert int(reply.headers["retry-after"]) >= 10
    ready = await running.client.get("/health/ready")
    assert (ready.status_code, ready.json()["storage"]) == (503, "not_writable")
    assert missing in ready.json()["waiting_for"][0]
    assert (await running.localize(map_id)).status_code == 200
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    refuse_writes(None)
    assert await running.status("GET", "/health/ready") == 200


@pytest.mark.slow
@pytest.mark.parametrize(("outcome", "number"), [("ready", errno.ENOSPC), ("failed", errno.EROFS)])
async def test_a_registration_under_way_waits_for_room_and_is_stored_then(
    running: RunningService,
    refuse_writes: Callable[[int | None], None],
    outcome: str,
    number: int,
) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    while not running.pool.registrations:
        await asyncio.sleep(0.01)
    if outcome == "failed":
        running.pool.fail_register.append(ValueError("a fault"))
    refuse_writes(number)
    running.pool.register_gate.set()
    await running.eventually(f"/maps/{map_id}", lambda body: body["stage"] == "waiting for room on the disk")
    refuse_writes(None)
    assert (await running.settled(map_id))["status"] == outcome
    registrations: Registrations = running.app.state.services.registrations
    while registrations.waiting_for_room:  # nothing waits for ever
        await asyncio.sleep(0.01)
