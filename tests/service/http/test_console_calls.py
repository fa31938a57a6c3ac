"""What the console asks for beside maps and answers: changes, images of batches, the demo room, the last errors."""

from dataclasses import replace
from typing import Any

import pytest

from panoloc.core.errors import ScanFormatError
from panoloc.service.host import demo_room
from panoloc.service.http.schemas.known_map import MapChanges
from panoloc.service.http.schemas.operations import Health
from tests.service.http.fake_pool import outcome_of
from tests.service.http.running_service import RunningService, png_of
from tests.service.maps.test_changes import seen

pytestmark = pytest.mark.anyio


def sees_changes(running: RunningService) -> None:
    """Let workers see one of two cells changed."""
    cells = seen((0, 0, 0), (1, 1, 1), changed=((1, 1, 1),))
    running.pool.outcome_of = lambda job: replace(outcome_of(job), change_cells=cells)


async def test_what_an_answer_saw_changed_is_shown_with_its_map_and_goes_with_it(running: RunningService) -> None:
    sees_changes(running)
    map_id = await running.ready_map()
    empty = await running.json(f"/maps/{map_id}/changes")
    assert (empty["answers"], empty["cells"], empty["cell_m"]) == ([], [], None)
    answer = (await running.localize(map_id)).json()
    changes = await running.json(f"/maps/{map_id}/changes")
    MapChanges.model_validate(changes)
    assert [each["id"] for each in changes["answers"]] == [answer["id"]]
    assert [cell["center_m"] for cell in changes["cells"]] == [[0.75, 0.75, 0.75]]
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    assert running.storage.names("changes") == []
    assert await running.status("GET", f"/maps/{map_id}/changes") == 404


async def test_what_an_answer_saw_of_a_map_that_was_deleted_meanwhile_is_not_kept(running: RunningService) -> None:
    sees_changes(running)
    map_id = await running.ready_map()
    asking = await running.held_query(map_id)
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    running.pool.localize_gate.set()
    assert (await asking).status_code == 200
    assert running.storage.names("changes") == []


async def test_images_of_a_batch_come_back_as_they_were(running: RunningService) -> None:
    picture = png_of(8, 4)
    files = [("image", ("a.png", picture)), ("image", ("notes.html", b"<script>alert(1)</script>"))]
    map_id = await running.ready_map()
    batch = (await running.client.post("/batches", files=files, data={"map_id": map_id})).json()
    first = await running.client.get(f"/batches/{batch['id']}/images/0")
    assert (first.content, first.headers["content-type"]) == (picture, "image/png")
    other = await running.client.get(f"/batches/{batch['id']}/images/1")
    assert (other.headers["content-type"], other.headers["x-content-type-options"]) == (
        "application/octet-stream",
        "nosniff",
    )
    assert await running.status("GET", f"/batches/{batch['id']}/images/2") == 404
    assert await running.status("GET", "/batches/batch_none/images/0") == 404


async def test_the_last_problems_are_listed_with_their_request_ids(running: RunningService) -> None:
    reply = await running.client.get("/maps/map_none")
    health: dict[str, Any] = await running.json("/health")
    Health.model_validate(health)
    (error,) = health["recent_errors"]
    assert (error["path"], error["status"], error["method"]) == ("/maps/map_none", 404, "GET")
    assert error["request_id"] == reply.headers["x-request-id"]
    assert "recent_errors" not in await running.json("/health/ready")


async def test_scans_that_could_not_be_registered_are_among_the_last_problems(running: RunningService) -> None:
    running.pool.fail_register.append(ScanFormatError("expected a scan, got two words"))
    failed = await running.settled((await running.upload()).json()["id"])
    assert failed["status"] == "failed"
    await running.client.get("/maps/map_none")
    later, earlier = (await running.json("/health"))["recent_errors"]
    assert later["path"] == "/maps/map_none"
    assert (earlier["method"], earlier["path"]) == ("POST", f"/maps/{failed['id']}")
    assert {name: earlier[name] for name in ("type", "detail", "request_id")} == {
        name: failed["error"][name] for name in ("type", "detail", "request_id")
    }
    await running.client.delete(f"/maps/{failed['id']}")
    assert [each["path"] for each in (await running.json("/health"))["recent_errors"]] == ["/maps/map_none"]


async def test_a_demo_room_that_cannot_be_made_is_a_problem(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_room, "_MAKER", "lab.no_such_module")
    reply = await running.client.get("/demo/room.ply")
    assert (reply.status_code, reply.headers["content-type"]) == (500, "application/problem+json")
    assert running.storage.names("uploads") == []


async def test_a_demo_room_is_made_once(running: RunningService) -> None:
    running.storage.put("demo/panorama.jpg", b"\xff\xd8\xff")
    reply = await running.client.get("/demo/panorama.jpg")
    assert (reply.content, reply.headers["content-type"]) == (b"\xff\xd8\xff", "image/jpeg")
