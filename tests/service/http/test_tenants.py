"""Keys of several tenants: each sees its own maps and those shared with it, and every change has its line."""

import io
import json
import zipfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.keys.caller import Scope
from panoloc.service.keys.key_file import KeyFile
from tests.service.http.running_service import SCAN, RunningService, png_of, running_service

pytestmark = pytest.mark.anyio


@dataclass
class House:
    """A service with three keys; each name opens what its tenant may."""

    running: RunningService
    keys: dict[str, str]

    async def ask(self, who: str, method: str, path: str, **request: Any) -> httpx.Response:
        headers = {"Authorization": f"Bearer {self.keys[who]}"}
        return await self.running.client.request(method, path, headers=headers, **request)

    async def ready_map(self, who: str) -> str:
        reply = await self.ask(who, "POST", "/maps", files={"file": ("office.ply", SCAN)})
        assert reply.status_code == 202, reply.text
        map_id = str(reply.json()["id"])
        for _ in range(500):
            if (await self.ask(who, "GET", f"/maps/{map_id}")).json()["status"] == "ready":
                return map_id
        raise AssertionError("it does not become ready")

    async def localize(self, who: str, **data: Any) -> httpx.Response:
        return await self.ask(who, "POST", "/localize", data=data, files={"image": ("photo.png", png_of(8, 4))})


@pytest.fixture
async def house(tmp_path: Path, redis_server: EmbeddedRedis) -> AsyncIterator[House]:
    file = KeyFile(tmp_path)
    everything: list[Scope] = ["read", "localize", "write"]
    keys = {
        "museum": file.make("museum", everything, tenant="museum")[1],
        "visitors": file.make("visitors", ["localize"], tenant="museum")[1],
        "school": file.make("school", everything, tenant="school")[1],
        "admin": file.make("admin", ["admin"])[1],
    }
    async with running_service(tmp_path, redis_server.url) as running:
        yield House(running, keys)


async def test_health_counts_the_maps_that_a_key_sees(house: House) -> None:
    await house.ready_map("museum")
    seen = {who: (await house.ask(who, "GET", "/health")).json()["maps"] for who in ("museum", "school", "admin")}
    assert seen == {"museum": {"ready": 1}, "school": {}, "admin": {"ready": 1}}
    assert (await house.ask("school", "GET", "/health/ready")).json()["maps"] == {}


async def test_a_map_is_not_there_for_keys_of_other_tenants(house: House) -> None:
    map_id = await house.ready_map("museum")
    assert [(await house.ask(who, "GET", f"/maps/{map_id}")).status_code for who in ("museum", "school", "admin")] == [
        200,
        404,
        200,
    ]
    asked = [
        ("GET", f"/maps/{map_id}/preview.png"), ("GET", f"/maps/{map_id}/points"), ("GET", f"/maps/{map_id}/changes"),
        ("GET", f"/{map_id}/capabilities"), ("DELETE", f"/maps/{map_id}"),
    ]  # fmt: skip
    assert [(await house.ask("school", method, path)).status_code for method, path in asked] == [404] * len(asked)
    assert (await house.ask("school", "PATCH", f"/maps/{map_id}", json={"name": "mine"})).status_code == 404
    # In the same words as one that there never was.
    hidden, unknown = [
        (await house.ask("school", "GET", f"/maps/{each}")).json()["detail"] for each in (map_id, "map_never")
    ]
    assert "does not share it with this key" in hidden
    assert hidden.replace(map_id, "map_never") == unknown
    assert (
        await house.ask("school", "PUT", f"/maps/{map_id}/scan", files={"file": ("a.ply", SCAN)})
    ).status_code == 404
    assert (await house.localize("school", map_id=map_id)).status_code == 404
    assert (await house.ask("school", "GET", "/maps")).json()["items"] == []
    assert [each["id"] for each in (await house.ask("admin", "GET", "/maps")).json()["items"]] == [map_id]


async def test_a_shared_map_is_seen_and_asked_but_not_changed(house: House) -> None:
    map_id = await house.ready_map("museum")
    patch = {"shared_with": ["school"], "tags": ["hall"]}
    assert (await house.ask("museum", "PATCH", f"/maps/{map_id}", json=patch)).json()["shared_with"] == ["school"]
    assert (await house.localize("school", map_id=map_id)).status_code == 200
    assert (await house.localize("school", tag="hall")).status_code == 200
    assert [each["id"] for each in (await house.ask("school", "GET", "/maps")).json()["items"]] == [map_id]
    for method, request in (("DELETE", {}), ("PATCH", {"json": {"name": "mine"}})):
        reply = await house.ask("school", method, f"/maps/{map_id}", **request)
        assert (reply.status_code, reply.json()["type"]) == (403, "/problems/scope-missing")
    await house.ask("museum", "PATCH", f"/maps/{map_id}", json={"shared_with": []})
    assert (await house.localize("school", tag="hall")).status_code == 404


async def test_a_key_that_may_localize_alone_reads_no_scan(house: House) -> None:
    map_id = await house.ready_map("museum")
    assert (await house.localize("visitors", map_id=map_id)).status_code == 200
    for path in ("/maps", f"/maps/{map_id}", f"/maps/{map_id}/points", "/metrics"):
        assert (await house.ask("visitors", "GET", path)).status_code == 403
    assert (await house.ask("visitors", "DELETE", f"/maps/{map_id}")).status_code == 403


@pytest.mark.slow
async def test_a_batch_is_there_for_its_tenant_alone(house: House) -> None:
    map_id = await house.ready_map("museum")
    files = {"image": ("a.png", png_of(8, 4))}
    made = await house.ask("visitors", "POST", "/batches", data={"map_id": map_id}, files=files)
    assert made.status_code == 202, made.text
    path = f"/batches/{made.json()['id']}"
    assert [(await house.ask(who, "GET", path)).status_code for who in ("museum", "school", "admin")] == [200, 404, 200]
    listed = {who: (await house.ask(who, "GET", "/batches")) for who in ("museum", "school", "admin", "visitors")}
    assert [len(listed[who].json()["items"]) for who in ("museum", "school", "admin")] == [1, 0, 1]
    assert listed["visitors"].status_code == 403
    assert (await house.ask("school", "DELETE", path)).status_code == 404
    assert (await house.ask("school", "POST", "/batches", data={"map_id": map_id}, files=files)).status_code == 404
    assert (await house.ask("museum", "DELETE", path)).status_code == 204


@pytest.mark.slow
async def test_an_export_and_a_plan_show_nothing_of_maps_of_others_by_name(house: House) -> None:
    own, other = await house.ready_map("museum"), await house.ready_map("school")
    made = await house.ask("museum", "POST", "/batches", data={"map_id": own}, files={"image": ("a.png", png_of(8, 4))})
    path = f"/batches/{made.json()['id']}"
    exports = {}
    for map_id in (own, other, "map_none"):
        reply = await house.ask("museum", "GET", f"{path}/export?format=colmap&map_id={map_id}")
        with zipfile.ZipFile(io.BytesIO(reply.content)) as archive:
            exports[map_id] = len(archive.read("points3D.txt").splitlines())
    assert exports == {own: 11, other: 1, "map_none": 1}
    shown = []
    for map_id in (other, "map_none"):
        reply = await house.ask("museum", "GET", f"{path}/plan.png?map_id={map_id}")
        with Image.open(io.BytesIO(reply.content)) as plan:
            shown.append(np.asarray(plan.convert("RGB"))[:500])  # without the name below
    assert np.array_equal(shown[0], shown[1])


async def test_the_last_problems_are_shown_to_who_sees_all_maps(house: House) -> None:
    await house.ask("museum", "GET", "/maps/map_secret")
    assert (await house.ask("school", "GET", "/health")).json()["recent_errors"] == []
    assert (await house.ask("admin", "GET", "/health")).json()["recent_errors"] != []


async def test_every_change_has_its_line_with_key_and_request(house: House) -> None:
    map_id = await house.ready_map("museum")
    await house.ask("museum", "PATCH", f"/maps/{map_id}", json={"name": "hall"})
    await house.ask("school", "DELETE", f"/maps/{map_id}")
    replaced = await house.ask("museum", "PUT", f"/maps/{map_id}/scan", files={"file": ("a.ply", SCAN)})
    await house.ask("admin", "DELETE", f"/maps/{map_id}")
    lines = [json.loads(line) for line in (house.running.data_dir / "audit.jsonl").read_text().splitlines()]
    assert [line["change"] for line in lines] == ["map registered", "map changed", "scan replaced", "map deleted"]
    assert {line["what"] for line in lines} == {map_id}
    names = {f"key {key.id}": key.name for key in KeyFile(house.running.data_dir).read()}
    assert [names[line["who"]] for line in lines] == ["museum", "museum", "museum", "admin"]
    assert lines[2]["request_id"] == replaced.headers["x-request-id"]


async def test_a_key_that_is_made_while_the_service_runs_closes_it_to_all_others(
    running: RunningService, tmp_path: Path
) -> None:
    running.app.state.services.settings.keys._look_s = 0.0
    assert (await running.client.get("/maps")).status_code == 200
    _, text = KeyFile(tmp_path).make("reader", ["read"])
    assert (await running.client.get("/maps")).status_code == 401
    assert (await running.client.get("/maps", headers={"X-API-Key": text})).status_code == 200
