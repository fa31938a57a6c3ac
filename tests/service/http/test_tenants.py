"""Keys of several tenants: each sees its own maps and those shared with it, and every change has its line."""

import io
import json
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from panoloc.service.keys.caller import Scope
from panoloc.service.keys.key_file import KeyFile
from tests.service.http.running_service import RunningService, Serve

pytestmark = pytest.mark.anyio


Callers = dict[str, RunningService]


@pytest.fixture
async def callers(tmp_path: Path, serve: Serve, anyio_backend: str) -> AsyncIterator[Callers]:
    """Return the service as callers with keys of several tenants have it, by their names."""
    file = KeyFile(tmp_path)
    everything: list[Scope] = ["read", "localize", "write"]
    keys = {
        "museum": file.make("museum", everything, tenant="museum")[1],
        "visitors": file.make("visitors", ["localize"], tenant="museum")[1],
        "school": file.make("school", everything, tenant="school")[1],
        "admin": file.make("admin", ["admin"])[1],
    }
    async with serve() as running:
        yield {name: running.by(key) for name, key in keys.items()}


async def statuses(callers: Callers, path: str, *names: str) -> list[int]:
    return [await callers[name].status("GET", path) for name in names]


async def test_health_counts_the_maps_that_a_key_sees(callers: Callers) -> None:
    await callers["museum"].ready_map()
    seen = {who: (await callers[who].json("/health"))["maps"] for who in ("museum", "school", "admin")}
    assert seen == {"museum": {"ready": 1}, "school": {}, "admin": {"ready": 1}}
    assert (await callers["school"].json("/health/ready"))["maps"] == {}


async def test_an_answer_in_a_map_that_a_key_does_not_see_is_unknown_as_a_prior(callers: Callers) -> None:
    map_id, other = await callers["museum"].ready_map(), await callers["school"].ready_map()
    answer = (await callers["museum"].localize(map_id)).json()
    hints = json.dumps({"hints": {"prior": {"localization_id": answer["id"]}}})
    assert (await callers["visitors"].localize(map_id, options=hints)).status_code == 200
    refused = (await callers["school"].localize(other, options=hints)).json()
    unknown = (await callers["school"].localize(other, options=hints.replace(answer["id"], "loc_never"))).json()
    assert refused["status"] == 404
    assert refused["detail"].replace(answer["id"], "loc_never") == unknown["detail"]


async def test_an_answer_is_there_for_its_tenant_alone_even_in_a_shared_map(callers: Callers) -> None:
    museum, school = callers["museum"], callers["school"]
    map_id = await museum.ready_map()
    await museum.client.patch(f"/maps/{map_id}", json={"shared_with": ["school"]})
    asked = json.dumps({"artifacts": ["overlay"]})
    at_once = f"/localizations/{(await museum.localize(map_id, options=asked)).json()['id']}"
    begun = await museum.localize(map_id, options=asked, headers={"Prefer": "respond-async"})
    for path in (at_once, begun.headers["Location"]):
        for shown in (path, f"{path}/overlay.png"):
            await museum.eventually(path, lambda body: body["status"] == "localized")
            assert await statuses(callers, shown, "museum", "visitors", "school", "admin") == [200, 200, 404, 200]
        assert await school.status("DELETE", path) == 404
        assert set(await museum.json(path)).isdisjoint({"tenant", "is_tracked"})
        assert await callers["visitors"].status("DELETE", path) == 204
        assert await statuses(callers, path, "museum") == [404]
    hidden, unknown = [(await school.json(path))["detail"] for path in (at_once, "/localizations/loc_never")]
    assert hidden.replace(at_once.rpartition("/")[2], "loc_never") == unknown


async def test_a_map_is_not_there_for_keys_of_other_tenants(callers: Callers) -> None:
    school, map_id = callers["school"], await callers["museum"].ready_map()
    assert await statuses(callers, f"/maps/{map_id}", "museum", "school", "admin") == [200, 404, 200]
    for path in (f"/maps/{map_id}/preview.png", f"/maps/{map_id}/points", f"/maps/{map_id}/changes"):
        assert await school.status("GET", path) == 404
    assert await school.status("GET", f"/{map_id}/capabilities") == 404
    assert await school.status("DELETE", f"/maps/{map_id}") == 404
    assert await school.status("PATCH", f"/maps/{map_id}", json={"name": "mine"}) == 404
    assert (await school.replace_scan(map_id)).status_code == 404
    assert (await school.localize(map_id)).status_code == 404
    # In the same words as one that there never was.
    hidden, unknown = [(await school.json(f"/maps/{each}"))["detail"] for each in (map_id, "map_never")]
    assert "does not share it with this key (shared_with); see" in hidden
    assert hidden.replace(map_id, "map_never") == unknown
    # Whoever sees a map is told the id of one that was named.
    await callers["museum"].client.patch(f"/maps/{map_id}", json={"name": "the hall"})
    told = [(await callers[each].json("/maps/the%20hall"))["detail"] for each in ("museum", "school")]
    assert [f"the name of {map_id}; send the id" in words for words in told] == [True, False]
    assert (await school.json("/maps"))["items"] == []
    assert [each["id"] for each in (await callers["admin"].json("/maps"))["items"]] == [map_id]


async def test_a_shared_map_is_seen_and_asked_but_not_changed(callers: Callers) -> None:
    museum, school = callers["museum"], callers["school"]
    map_id = await museum.ready_map()
    patch = {"shared_with": ["school"], "tags": ["hall"]}
    assert (await museum.client.patch(f"/maps/{map_id}", json=patch)).json()["shared_with"] == ["school"]
    assert (await school.localize(map_id)).status_code == 200
    assert (await school.localize(None, tag="hall")).status_code == 200
    assert [each["id"] for each in (await school.json("/maps"))["items"]] == [map_id]
    mine = await school.client.patch(f"/maps/{map_id}", json={"name": "mine"})
    for reply in (mine, await school.client.delete(f"/maps/{map_id}")):
        assert (reply.status_code, reply.json()["type"]) == (403, "/problems/scope-missing")
    await museum.client.patch(f"/maps/{map_id}", json={"shared_with": []})
    assert (await school.localize(None, tag="hall")).status_code == 404


async def test_a_key_that_may_localize_alone_reads_no_scan(callers: Callers) -> None:
    visitors, map_id = callers["visitors"], await callers["museum"].ready_map()
    assert (await visitors.localize(map_id)).status_code == 200
    for path in ("/maps", f"/maps/{map_id}", f"/maps/{map_id}/points", "/metrics"):
        assert await visitors.status("GET", path) == 403
    refused = (await visitors.client.get(f"/maps/{map_id}")).json()["detail"]
    assert (
        refused == f"expected a key with the scope 'read', got one without it for GET /maps/{map_id}; use another key"
    )
    assert await visitors.status("DELETE", f"/maps/{map_id}") == 403


@pytest.mark.slow
async def test_a_batch_is_there_for_its_tenant_alone(callers: Callers) -> None:
    map_id = await callers["museum"].ready_map()
    made = await callers["visitors"].post_batch(map_id, "a.png")
    assert made.status_code == 202, made.text
    path = f"/batches/{made.json()['id']}"
    assert await statuses(callers, path, "museum", "school", "admin") == [200, 404, 200]
    listed = [len((await callers[who].json("/batches"))["items"]) for who in ("museum", "school", "admin")]
    assert listed == [1, 0, 1]
    assert await callers["visitors"].status("GET", "/batches") == 403
    assert await callers["school"].status("DELETE", path) == 404
    assert await callers["school"].status("PATCH", path, json={"name": "ours"}) == 404
    assert (await callers["school"].post_batch(map_id, "a.png")).status_code == 404
    assert await callers["museum"].status("DELETE", path) == 204


@pytest.mark.slow
async def test_an_export_and_a_plan_show_nothing_of_maps_of_others_by_name(callers: Callers) -> None:
    museum, school = callers["museum"], callers["school"]
    shared, other = await school.ready_map(), await school.ready_map()
    await school.client.patch(f"/maps/{shared}", json={"shared_with": ["museum"]})
    _, batch_id = await museum.placed("a.png", map_id=shared)
    plans = []
    for tenants, points in ((["museum"], 11), ([], 1)):
        await school.client.patch(f"/maps/{shared}", json={"shared_with": tenants})
        reply = await museum.client.get(f"/batches/{batch_id}/export?format=colmap&map_id={shared}")
        with zipfile.ZipFile(io.BytesIO(reply.content)) as archive:
            assert len(archive.read("points3D.txt").splitlines()) == points
        plans.append((await museum.client.get(f"/batches/{batch_id}/plan.png?map_id={shared}")).content)
    await school.client.delete(f"/maps/{shared}")
    plans.append((await museum.client.get(f"/batches/{batch_id}/plan.png?map_id={shared}")).content)
    assert plans[0] != plans[1] == plans[2]
    # One that is not there is refused in the same words as one of others.
    for path in ("export?format=colmap&", "plan.png?"):
        replies = [await museum.client.get(f"/batches/{batch_id}/{path}map_id={each}") for each in (other, "map_none")]
        assert [reply.status_code for reply in replies] == [422, 422]
        assert replies[0].json()["detail"].replace(other, "map_none") == replies[1].json()["detail"]


async def test_the_last_problems_are_shown_to_who_sees_all_maps(callers: Callers) -> None:
    await callers["museum"].client.get("/maps/map_secret")
    assert (await callers["school"].json("/health"))["recent_errors"] == []
    assert (await callers["admin"].json("/health"))["recent_errors"] != []


async def test_every_change_has_its_line_with_key_and_request(callers: Callers) -> None:
    map_id = await callers["museum"].ready_map()
    await callers["museum"].client.patch(f"/maps/{map_id}", json={"name": "hall"})
    await callers["school"].client.delete(f"/maps/{map_id}")
    replaced = await callers["museum"].replace_scan(map_id)
    await callers["admin"].client.delete(f"/maps/{map_id}")
    lines = [json.loads(line) for line in (callers["admin"].data_dir / "audit.jsonl").read_text().splitlines()]
    assert [line["change"] for line in lines] == ["map registered", "map changed", "scan replaced", "map deleted"]
    assert {line["what"] for line in lines} == {map_id}
    names = {f"key {key.id}": key.name for key in KeyFile(callers["admin"].data_dir).read()}
    assert [names[line["who"]] for line in lines] == ["museum", "museum", "museum", "admin"]
    assert lines[2]["request_id"] == replaced.headers["x-request-id"]


async def test_a_key_that_is_made_while_the_service_runs_closes_it_to_all_others(
    running: RunningService, tmp_path: Path
) -> None:
    running.app.state.services.settings.keys._look_s = 0.0
    assert await running.status("GET", "/maps") == 200
    _, text = KeyFile(tmp_path).make("reader", ["read"])
    assert await running.status("GET", "/maps") == 401
    assert await running.status("GET", "/maps", headers={"X-API-Key": text}) == 200
