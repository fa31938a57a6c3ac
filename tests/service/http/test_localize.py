"""Queries over HTTP: answers, pictures, answers fetched later, and what is refused."""

import asyncio
import json
import time
from collections.abc import MutableMapping
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest
import redis

from panoloc.core.errors import DeadlineExceededError, PanoramaShapeError, ScanContentError
from panoloc.core.geometry.pose import Pose
from panoloc.service.answer import Localization
from panoloc.service.errors import QueueFullError, StoredFileMissingError, WorkerError
from panoloc.service.http.routes.localize import checked_options
from panoloc.service.http.schemas.queries import LocalizeOptions, PendingLocalization
from panoloc.service.jobs import ARTIFACTS, QueryImage
from panoloc.service.settings import Settings
from tests.service.http.fake_pool import PNG, POSE, no_worker
from tests.service.http.running_service import RunningService, Serve, png_of

pytestmark = pytest.mark.anyio


async def test_an_answer_and_its_pictures_can_be_fetched_for_a_while(
    running: RunningService, redis_client: "redis.Redis"
) -> None:
    options = json.dumps({"artifacts": ARTIFACTS})
    body = (await running.localize(map_id := await running.ready_map(), options=options)).json()
    Localization.model_validate(body)
    assert body["map_id"] == map_id
    assert {"queue", "decode", "search", "total"} == body["timings_s"].keys()
    assert body["timings_s"]["total"] >= body["timings_s"]["queue"] >= 0
    assert await running.json(f"/localizations/{body['id']}") == body
    paths = [f"/localizations/{body['id']}/{name}.png" for name in ("score-map-2d", "score-map-3d", "overlay")]
    assert body["artifacts"] == dict(zip(ARTIFACTS, paths, strict=True))
    for name, path in body["artifacts"].items():
        picture = await running.client.get(path)
        assert (picture.content, picture.headers["content-type"]) == (PNG + name.encode(), "image/png")
    lifetimes = [redis_client.ttl(key) for key in redis_client.keys("*") if body["id"] in key]
    assert len(lifetimes) == 4
    assert all(0 < lifetime <= 3600 for lifetime in lifetimes)


async def test_a_picture_that_the_query_did_not_ask_for_is_404(running: RunningService) -> None:
    body = (await running.localize(await running.ready_map())).json()
    reply = await running.client.get(f"/localizations/{body['id']}/score-map-3d.png")
    assert reply.status_code == 404
    assert "artifacts" in reply.json()["detail"]
    assert await running.status("GET", "/localizations/loc_none/overlay.png") == 404


async def test_the_worker_gets_every_option_and_a_deadline(running: RunningService) -> None:
    map_id = await running.ready_map()
    await running.localize(
        map_id, options='{"hints": {"heading_deg": 90}, "timeout_s": 7}', headers={"X-Request-ID": "abc"}
    )
    (job,) = running.pool.jobs
    assert job.request_id == "abc"
    assert (job.maps[0].id, job.maps[0].revision) == (map_id, 1)
    assert job.options.frame == "ros"
    assert job.options.hints is not None
    assert job.options.hints.heading_deg == 90
    assert job.options.hints.radius_m is None
    assert 0 < job.deadline_unix_s - time.time() <= 7


@pytest.mark.parametrize(
    ("options", "settings", "timeout_s"),
    [
        ({}, {}, 60),
        ({"method": "paper"}, {}, 600),
        ({"method": "paper"}, {"max_timeout_s": 300}, 300),
        ({}, {"max_timeout_s": 30}, 30),
        ({"method": "paper"}, {"default_timeout_s": 900, "max_timeout_s": 1800}, 900),
        ({"method": "paper", "timeout_s": 7}, {}, 7),
        ({"cameras": [{"model": "pinhole", "hfov_range_deg": [45, 90]}]}, {}, 600),
        ({"cameras": [{"model": "pinhole", "hfov_deg": 70}]}, {}, 60),
    ],
)
def test_a_query_without_a_timeout_has_the_time_that_its_method_takes(
    options: dict[str, Any], settings: dict[str, Any], timeout_s: float
) -> None:
    given = LocalizeOptions.model_validate(options)
    assert checked_options(given, Settings(**settings)).timeout_s == timeout_s


async def test_panorama_and_mask_reach_the_worker_unchanged(running: RunningService) -> None:
    panorama, mask = png_of(16, 8), png_of(16, 8)
    await running.localize(await running.ready_map(), panorama, files={"mask": ("mask.png", mask)})
    assert running.pool.jobs[0].images == (QueryImage(panorama, mask),)


async def test_images_are_kept_only_when_the_setting_says_so(running: RunningService) -> None:
    map_id = await running.ready_map()
    await running.localize(map_id)
    assert running.storage.names("panoramas") == []
    localizations = running.app.state.services.localizations
    localizations.settings = localizations.settings.model_copy(update={"keep_images": True})
    body = (await running.localize(map_id)).json()
    assert running.storage.names("panoramas") == [f"{body['id']}.png"]


async def test_several_maps_are_searched_each_once(running: RunningService) -> None:
    first, second = await running.ready_map(), await running.ready_map()
    files = [("map_id", (None, map_id)) for map_id in (first, second, first)]
    reply = await running.client.post("/localize", files=[*files, ("image", ("a.png", png_of(8, 4)))])
    assert reply.status_code == 200
    assert [ref.id for ref in running.pool.jobs[0].maps] == [first, second]


async def test_a_tag_selects_the_maps_that_are_ready_and_warns_of_the_others(running: RunningService) -> None:
    ready = await running.ready_map('{"tags": ["b7"]}')
    running.pool.fail_register = [ScanContentError("no colour")]
    failed = (await running.upload(options='{"tags": ["b7"]}')).json()["id"]
    await running.settled(failed)
    body = (await running.localize(None, tag="b7")).json()
    assert [ref.id for ref in running.pool.jobs[0].maps] == [ready]
    assert any(failed in warning for warning in body["warnings"])
    assert (await running.localize(None, tag="nobody")).status_code == 404


@pytest.mark.settings(search_all=True)
async def test_where_the_operator_allows_it_a_query_that_names_no_map_searches_all_that_are_ready(
    running: RunningService,
) -> None:
    image = ("image", ("a.png", png_of(8, 4)))
    assert (await running.client.post("/localize", files=[image])).status_code == 404
    ready = [await running.ready_map(), await running.ready_map()]
    running.pool.fail_register = [ScanContentError("no colour")]
    await running.settled((await running.upload()).json()["id"])
    reply = await running.client.post("/localize", files=[image])
    assert reply.status_code == 200
    assert "1 of 3 maps are not ready and were not searched" in reply.json()["warnings"]
    assert sorted(ref.id for ref in running.pool.jobs[-1].maps) == sorted(ready)


async def test_a_query_may_name_hundreds_of_maps(running: RunningService) -> None:
    await running.ready_map('{"tags": ["campus"]}')
    registry = running.app.state.services.registry
    (record,) = registry.with_tag("campus")
    others = [replace(record, id=f"map_{number}") for number in range(200)]
    registry._records |= {each.id: each for each in others}
    assert (await running.localize(None, tag="campus")).status_code == 200
    assert len(running.pool.jobs[-1].maps) == 201


async def test_a_map_that_is_not_ready_is_409_with_retry_after(running: RunningService) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    reply = await running.localize(map_id)
    assert (reply.status_code, reply.json()["type"]) == (409, "/problems/map-not-ready")
    assert int(reply.headers["retry-after"]) >= 1


async def test_a_failed_map_is_409_without_retry_after(running: RunningService) -> None:
    running.pool.fail_register = [ScanContentError("expected colours, got none")]
    map_id = (await running.upload()).json()["id"]
    await running.settled(map_id)
    reply = await running.localize(map_id)
    assert (reply.status_code, reply.json()["type"]) == (409, "/problems/map-failed")
    assert "expected colours" in reply.json()["detail"]
    assert "retry-after" not in reply.headers


async def test_an_error_of_the_pool_becomes_its_problem(running: RunningService) -> None:
    map_id = await running.ready_map()
    for error, status in (
        (PanoramaShapeError("expected 2:1, got 3:2; crop it"), 422),
        (DeadlineExceededError("expected an answer in time"), 504),
        (WorkerError("RuntimeError", "expected"), 500),
        (QueueFullError("64 wait", 3), 429),
        (no_worker(), 503),
    ):
        running.pool.fail_localize = [error]
        reply = await running.localize(map_id)
        assert (reply.status_code, reply.json()["status"]) == (status, status)
        assert ("retry-after" in reply.headers) == (status in (429, 503))
        assert (await running.localize(map_id)).status_code == 200


async def test_a_query_whose_revision_was_replaced_is_repeated(running: RunningService) -> None:
    map_id = await running.ready_map()
    asking = await running.held_query(map_id)
    await running.replace_scan(map_id)
    await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 2)
    running.pool.fail_localize = [StoredFileMissingError("the scan is gone")]
    running.pool.localize_gate.set()
    assert (await asking).json()["map_revision"] == 2


async def test_a_caller_who_disconnects_cancels_the_query(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    request = httpx.Request("POST", "http://localhost", files={"image": png_of(8, 4)}, data={"map_id": map_id})
    received = asyncio.Queue[dict[str, object]]()
    received.put_nowait({"type": "http.request", "body": request.read(), "more_body": False})
    sent: list[MutableMapping[str, object]] = []

    async def send(message: MutableMapping[str, object]) -> None:
        sent.append(message)

    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "POST", "path": "/localize",
        "raw_path": b"/localize", "query_string": b"", "root_path": "", "scheme": "http", "server": ("panoloc", 80),
        "headers": [(name.lower(), value) for name, value in request.headers.raw],
    }  # fmt: skip
    asking = asyncio.create_task(running.app(scope, received.get, send))
    await running.pool.asked.wait()
    received.put_nowait({"type": "http.disconnect"})
    await asking
    assert running.pool.ended == ["localize"]
    assert sent[0]["status"] == 499


async def test_an_answer_can_be_fetched_later(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    reply = await running.localize(map_id, headers={"Prefer": "wait=5, respond-async"})
    assert reply.status_code == 202
    path = reply.headers["location"]
    PendingLocalization.model_validate(reply.json())
    body = await running.eventually(path, lambda body: body["status"] == "running")
    assert "due_unix_s" not in body
    running.pool.localize_gate.set()
    body = await running.eventually(path, lambda body: body["status"] not in ("queued", "running"))
    Localization.model_validate(body)
    assert path == f"/localizations/{body['id']}"


async def test_a_query_that_fails_later_has_its_error_in_place_of_the_answer(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    running.pool.fail_localize = [PanoramaShapeError("expected 2:1, got 3:2")]
    reply = await running.localize(map_id, headers={"Prefer": "respond-async"})
    running.pool.localize_gate.set()
    body = await running.eventually(reply.headers["location"], lambda body: body["status"] == "failed")
    assert body["error"]["type"] == "/problems/not-a-panorama"
    PendingLocalization.model_validate(body)


async def test_a_full_queue_is_429_also_for_an_answer_fetched_later(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.fail_localize = [QueueFullError("64 wait", 3)]
    reply = await running.localize(map_id, headers={"Prefer": "respond-async"})
    assert (reply.status_code, reply.headers["retry-after"]) == (429, "3")


async def test_a_query_that_was_lost_with_the_service_has_failed(
    running: RunningService, redis_client: "redis.Redis"
) -> None:
    state = {"id": "loc_x", "status": "running", "created_at": "2026-01-01T00:00:00Z", "error": None, "due_unix_s": 1.0}
    redis_client.set("localization:loc_x", json.dumps(state))
    body = await running.json("/localizations/loc_x")
    assert (body["status"], body["error"]["status"]) == ("failed", 504)


async def test_a_query_needs_no_room_in_the_storage(running: RunningService, monkeypatch: pytest.MonkeyPatch) -> None:
    map_id = await running.ready_map()
    monkeypatch.setattr(running.storage, "spool_folder", lambda: pytest.fail("a query spools nothing"))
    assert (await running.localize(map_id)).status_code == 200


@pytest.mark.parametrize("frame", ["ros", "webxr"])
async def test_the_pose_of_an_answer_can_be_sent_as_a_prior_as_it_is(running: RunningService, frame: str) -> None:
    map_id = await running.ready_map()
    first = (await running.localize(map_id, options=json.dumps({"frame": frame}))).json()
    prior = {"pose": first["pose"], "position_std_m": 0.5}
    assert (await running.localize(map_id, options=json.dumps({"hints": {"prior": prior}}))).status_code == 200
    hints = running.pool.jobs[-1].options.hints
    assert hints is not None
    assert hints.prior is not None
    sent = hints.prior
    found = Pose.from_frame(sent.position_m, sent.quaternion_xyzw, sent.frame)
    np.testing.assert_allclose(found.matrix, POSE.matrix, atol=1e-9)
    assert (sent.position_std_m, sent.orientation_std_deg, hints.is_narrowing) == (0.5, 5.0, False)


async def test_a_prior_needs_one_map_and_a_pose(running: RunningService) -> None:
    maps = [await running.ready_map() for _ in "12"]
    pose = (await running.localize(maps[0])).json()["pose"]
    for given, map_ids, said in (
        ({"pose": pose}, maps, "hints.prior: expected a query of one map_id"),
        ({"pose": {"frame": "ros"}}, maps[:1], "hints.prior.pose.map_from_camera: expected a value"),
        ({"pose": pose, "position_std": 1}, maps[:1], "perhaps you mean position_std_m"),
    ):
        form = {"map_id": map_ids, "options": json.dumps({"hints": {"prior": given}})}
        reply = await running.client.post("/localize", data=form, files={"image": ("photo.png", png_of(8, 4))})
        assert reply.status_code == 422
        assert said in reply.json()["detail"]
    slow = json.dumps({"hints": {"prior": {"pose": pose}}, "method": "paper"})
    assert "expected the method fast" in (await running.localize(maps[0], options=slow)).json()["detail"]


async def test_the_time_of_a_drain_is_waited_for_once(serve: Serve) -> None:
    async with serve(drain_s=1.0, is_held=True) as running:
        map_id = await running.ready_map()
        await running.localize(map_id, headers={"Prefer": "respond-async"})
        running.app.state.services.begin_drain()
        await asyncio.sleep(0.9)
        began = time.monotonic()
    assert time.monotonic() - began < 0.7
