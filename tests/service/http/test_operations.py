"""Health, metrics, request ids, keys, HEAD; Redis that goes away; the service that starts again."""

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import httpx
import pytest

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.http import request_context
from panoloc.service.http.schemas.operations import Health
from panoloc.service.limits.caller_rates import WrongKeys
from tests.service.http.running_service import Listen, RunningService, Serve, running_service
from tests.service.started_redis import started_redis

pytestmark = pytest.mark.anyio

ROOT = Path(__file__).parents[3]


async def test_live_is_200_whatever_is_missing(running: RunningService) -> None:
    running.pool.is_ready = False
    assert await running.json("/health/live") == {"status": "live"}


async def test_ready_says_what_it_waits_for(running: RunningService) -> None:
    reply = await running.client.get("/health/ready")
    Health.model_validate(reply.json())
    assert (reply.status_code, reply.json()["waiting_for"]) == (200, [])
    running.pool.is_ready = False
    reply = await running.client.get("/health/ready")
    assert (reply.status_code, reply.json()["waiting_for"]) == (503, ["workers"])
    assert reply.headers["retry-after"]
    assert await running.status("GET", "/health") == 200


async def test_metrics_count_requests_by_route_and_never_by_path(running: RunningService) -> None:
    map_id = await running.ready_map()
    await running.localize(map_id)
    await running.client.get("/nowhere/" + "x" * 50)
    await running.client.request("BREW", "/maps")
    text = (await running.client.get("/metrics")).text
    assert 'panoloc_http_requests_total{method="POST",route="/localize",status="200"} 1.0' in text
    assert 'route="/maps/{map_id}"' in text
    assert 'method="GET",route="unmatched",status="404"' in text
    assert 'method="other"' in text
    assert map_id not in text
    assert "xxxxx" not in text


async def test_metrics_tell_of_pool_stages_and_maps(running: RunningService) -> None:
    await running.localize(await running.ready_map())
    text = (await running.client.get("/metrics")).text
    for line in (
        "panoloc_workers 1.0",
        "panoloc_queue_depth 0.0",
        "panoloc_resident_index_bytes 17.0",
        'panoloc_index_loads_total{source="redis"} 2.0',
        'panoloc_maps{status="ready"} 1.0',
        'panoloc_localizations_total{method="fast",result="localized"} 1.0',
        'panoloc_localization_stage_duration_seconds_count{stage="search"} 1.0',
        'panoloc_registrations_total{result="ready"} 1.0',
    ):
        assert line in text, line


async def test_a_request_id_is_taken_over_unless_it_would_harm_a_log(running: RunningService) -> None:
    for given in ("abc-123", "0af7651916cd43dd8448eb211c80319c"):
        reply = await running.client.get("/maps/none", headers={"X-Request-ID": given})
        assert reply.headers["x-request-id"] == reply.json()["request_id"] == given
    for given in ("", "a b", "x" * 129, 'a"b', "a{b}"):
        reply = await running.client.get("/maps/none", headers={"X-Request-ID": given})
        assert re.fullmatch(r"req_[0-9a-f]{16}", reply.headers["x-request-id"])


@pytest.mark.parametrize(("sent", "logged"), [("/a%00%0Ab", r"'/a\x00\nb'"), ("/maps/büro", "/maps/büro")])
async def test_a_path_is_logged_without_what_would_harm_a_log(
    running: RunningService, monkeypatch: pytest.MonkeyPatch, sent: str, logged: str
) -> None:
    log = Mock()
    monkeypatch.setattr(request_context, "_log", log)
    await running.client.get(sent)
    assert log.log.call_args.kwargs["path"] == logged


async def test_a_fault_of_the_service_is_a_problem_too(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running.app.state.services, "registry", None)
    reply = await running.client.get("/maps")
    assert reply.status_code == 500
    assert reply.headers["content-type"] == "application/problem+json"
    assert "NoneType" not in reply.text


@pytest.mark.slow
@pytest.mark.settings(api_keys="the-writer,the-reader:read")
async def test_keys_are_asked_for_and_scopes_kept(running: RunningService) -> None:
    reply = await running.upload()
    assert (reply.status_code, reply.json()["type"]) == (401, "/problems/key-missing")
    assert reply.headers["www-authenticate"].startswith("Bearer")
    running.client.headers["Authorization"] = "Bearer wrong-key"
    assert await running.status("GET", "/maps") == 401
    running.client.headers["Authorization"] = "Bearer the-reader"
    assert await running.status("GET", "/maps") == 200
    assert (await running.upload()).status_code == 403
    del running.client.headers["Authorization"]
    running.client.headers["X-API-Key"] = "the-writer"
    assert (await running.upload()).status_code == 202
    running.client.headers.clear()
    for path in ("/health/live", "/health/ready", "/"):
        assert await running.status("GET", path) == 200


@pytest.mark.settings(api_keys="the-reader:read")
async def test_with_keys_set_what_tells_of_the_service_asks_for_one(running: RunningService) -> None:
    for path in ("/health", "/metrics", "/openapi.json", "/docs"):
        assert await running.status("GET", path) == 401
        assert await running.by("the-reader").status("GET", path) == 200


@pytest.mark.settings(api_keys="the-reader:read")
async def test_a_probe_without_a_key_learns_one_word(running: RunningService) -> None:
    assert await running.json("/health/ready") == {"status": "ready"}
    running.pool.is_ready = False
    reply = await running.client.get("/health/ready")
    assert (reply.status_code, reply.json()) == (503, {"status": "not_ready"})
    details = (await running.client.get("/health/ready", headers={"X-API-Key": "the-reader"})).json()
    assert details["waiting_for"] == ["workers"]


@pytest.mark.slow
@pytest.mark.settings(api_keys="the-reader:read")
async def test_wrong_keys_are_answered_slowly_one_after_the_other_and_right_ones_at_once(
    running: RunningService,
) -> None:
    running.app.state.services.wrong_keys = WrongKeys(pause_s=0.1, most_waiting=3)
    began = time.monotonic()
    guesses = [
        asyncio.create_task(running.client.get("/maps", headers={"X-API-Key": f"guess-number-{number}"}))
        for number in range(6)
    ]
    await asyncio.sleep(0.05)
    assert await running.status("GET", "/maps", headers={"X-API-Key": "the-reader"}) == 200
    assert not all(guess.done() for guess in guesses)
    replies = [await guess for guess in guesses]
    assert time.monotonic() - began > 0.25
    assert sorted(reply.status_code for reply in replies) == [401, 401, 401, 429, 429, 429]
    assert all(reply.headers["retry-after"] for reply in replies if reply.status_code == 429)


async def test_the_type_of_a_problem_leads_to_its_meaning(running: RunningService) -> None:
    problem = await running.json("/maps/none")
    meaning = await running.json(problem["type"])
    assert meaning["title"] == problem["title"]
    assert meaning["advice"]
    assert await running.status("GET", "/problems/none") == 404


@pytest.fixture
def own_redis() -> Iterator[EmbeddedRedis]:
    with started_redis() as server:
        yield server


@pytest.mark.slow
async def test_redis_away_is_503_and_back_is_200_without_a_restart(tmp_path: Path, own_redis: EmbeddedRedis) -> None:
    async with running_service(tmp_path, own_redis.url) as running:
        map_id = await running.ready_map()
        assert own_redis.pid is not None
        # A stopped process does not come back by itself; one that is gone does.
        own_redis._stopping.set()
        os.kill(own_redis.pid, signal.SIGKILL)
        for reply in (await running.localize(map_id), await running.client.get("/localizations/loc_x")):
            assert (reply.status_code, reply.json()["type"]) == (503, "/problems/cache-down")
            assert int(reply.headers["retry-after"]) >= 1
        assert running.pool.jobs == []  # no worker computes for a caller who gets nothing
        assert await running.status("DELETE", f"/maps/{map_id}") == 503
        assert (await running.json("/health/ready"))["waiting_for"] == ["Redis"]
        assert (await running.json(f"/maps/{map_id}"))["status"] == "ready"
        waiting = (await running.upload()).json()["id"]
        assert "Redis" in (await running.json(f"/maps/{waiting}"))["stage"]
        own_redis._stopping.clear()
        own_redis._launch()
        own_redis._wait_until_it_answers()
        assert (await running.localize(map_id)).status_code == 200
        assert (await running.settled(waiting))["status"] == "ready"


async def test_an_unfinished_registration_goes_on_after_a_restart(serve: Serve) -> None:
    async with serve() as running:
        ready = await running.ready_map()
        running.pool.register_gate.clear()
        unfinished = (await running.upload()).json()["id"]
    async with serve() as running:
        assert (await running.settled(unfinished))["status"] == "ready"
        assert (await running.settled(ready))["status"] == "ready"
        assert [job.map.id for job in running.pool.registrations] == [unfinished]


async def test_maps_outlive_every_key_of_redis(running: RunningService, redis_client: object) -> None:
    map_id = await running.ready_map()
    redis_client.flushall()  # type: ignore[attr-defined]
    assert (await running.json(f"/maps/{map_id}"))["status"] == "ready"
    assert (await running.localize(map_id)).status_code == 200


@pytest.mark.slow
def test_the_application_loads_without_torch_ray_and_open3d() -> None:
    program = "import sys, panoloc.service.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    loaded = set(done.stdout.split())
    assert not {"torch", "ray", "open3d", "pyproj"} & loaded


@pytest.mark.slow
async def test_what_can_be_read_has_a_head(running: RunningService) -> None:
    map_id = await running.ready_map()
    for path in ("/", "/maps", f"/maps/{map_id}", f"/maps/{map_id}/preview.png", "/health/ready", "/metrics", "/docs"):
        whole, head = await running.client.get(path), await running.client.head(path)
        assert (head.status_code, head.content) == (whole.status_code, b"")
        assert head.headers["content-type"] == whole.headers["content-type"]
        assert whole.status_code == 200
    assert await running.status("HEAD", "/maps/map_none") == 404


async def test_what_only_takes_uploads_has_none(running: RunningService) -> None:
    refused = await running.client.head("/localize")
    assert (refused.status_code, refused.headers["allow"], refused.content) == (405, "POST", b"")


def test_over_a_socket_the_connection_goes_on_after_a_head(listen: Listen) -> None:
    with listen() as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(2):
            head = client.head("/health")
            assert head.status_code == 200
            assert int(head.headers["content-length"]) > 10
            assert client.get("/health/live").status_code == 200
