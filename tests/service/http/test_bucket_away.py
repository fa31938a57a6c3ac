"""A bucket that goes away, or lets nobody in any more: nothing is lost, everybody is told, and it goes on by itself."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from panoloc.service.errors import StorageAwayError
from panoloc.service.storage.bucket import BucketStorage
from tests.service.http.running_service import RunningService, Serve, png_of
from tests.service.storage.bucket_server import BUCKET, BucketServer

pytestmark = pytest.mark.anyio


@pytest.fixture
async def on_bucket(
    bucket_server: BucketServer, prefix: str, serve: Serve, monkeypatch: pytest.MonkeyPatch, anyio_backend: str
) -> AsyncIterator[RunningService]:
    for name, value in bucket_server.variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("panoloc.service.storage.bucket._PROBE_LASTS_S", 0.0)
    monkeypatch.setattr("panoloc.service.maps.registrations._ROOM_PAUSE_S", 0.02)
    async with serve(storage=f"s3://{BUCKET}/{prefix}") as running:
        yield running


@pytest.mark.slow
async def test_changes_and_uploads_are_503_while_it_is_away_and_queries_are_answered(
    on_bucket: RunningService, bucket_server: BucketServer
) -> None:
    map_id = await on_bucket.ready_map()
    assert await on_bucket.status("GET", "/health/ready") == 200
    with bucket_server.away():
        replies = await asyncio.gather(
            on_bucket.client.patch(f"/maps/{map_id}", json={"name": "new"}),
            on_bucket.upload(),
            on_bucket.client.delete(f"/maps/{map_id}"),
            on_bucket.client.get(f"/maps/{map_id}/preview.png"),
        )
        for reply in replies:
            assert (reply.status_code, reply.json()["type"]) == (503, "/problems/storage-away")
            assert int(reply.headers["retry-after"]) >= 10
        ready = await on_bucket.client.get("/health/ready")
        assert (ready.status_code, ready.json()["storage"]) == (503, "not_writable")
        assert ready.json()["waiting_for"] == ["the bucket"]
        assert (await on_bucket.localize(map_id)).status_code == 200
        assert list(on_bucket.storage.spool_folder().iterdir()) == []
    assert await on_bucket.status("GET", "/health/ready") == 200
    assert (await on_bucket.client.patch(f"/maps/{map_id}", json={"name": "new"})).status_code == 200


async def test_a_batch_waits_for_a_bucket_that_cannot_be_read_and_loses_no_image(
    on_bucket: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.batches.runs._FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr("panoloc.service.batches.runs._LONGEST_PAUSE_S", 0.01)
    map_id = await on_bucket.ready_map()
    on_bucket.pool.is_ready = False
    files = [("image", (f"{number}.png", png_of(8, 4))) for number in range(3)]
    batch = (await on_bucket.client.post("/batches", files=files, data={"map_id": map_id})).json()["id"]
    num_refused = 0
    read = BucketStorage.read

    def refused(storage: BucketStorage, key: str) -> bytes:
        nonlocal num_refused
        if "/images/" in key and num_refused < 20:
            num_refused += 1
            raise StorageAwayError("away")
        return read(storage, key)

    monkeypatch.setattr(BucketStorage, "read", refused)
    on_bucket.pool.is_ready = True
    shown = await on_bucket.eventually(f"/batches/{batch}", lambda body: body["status"] == "done")
    assert (shown["counts"]["localized"], num_refused) == (3, 20)


async def test_a_key_that_was_revoked_is_said(on_bucket: RunningService, bucket_server: BucketServer) -> None:
    map_id = await on_bucket.ready_map()
    with bucket_server.refusing():
        reply = await on_bucket.client.patch(f"/maps/{map_id}", json={"name": "new"})
        ready = await on_bucket.json("/health/ready")
    assert (reply.status_code, reply.json()["type"]) == (503, "/problems/storage-read-only")
    assert "the key and its rights" in reply.json()["detail"]
    assert ready["waiting_for"] == ["a bucket that can be written"]


@pytest.mark.slow
@pytest.mark.parametrize("outcome", ["ready", "failed"])
async def test_a_registration_under_way_waits_for_the_bucket_and_is_stored_then(
    on_bucket: RunningService, bucket_server: BucketServer, outcome: str
) -> None:
    on_bucket.pool.register_gate.clear()
    map_id = (await on_bucket.upload()).json()["id"]
    while not on_bucket.pool.registrations:
        await asyncio.sleep(0.01)
    if outcome == "failed":
        on_bucket.pool.fail_register.append(ValueError("a fault"))
    with bucket_server.away():
        on_bucket.pool.register_gate.set()
        await on_bucket.eventually(f"/maps/{map_id}", lambda body: body["stage"] == "waiting for the storage")
    assert (await on_bucket.settled(map_id))["status"] == outcome
