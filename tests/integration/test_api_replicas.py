"""Two services on machines of their own over one bucket and one Redis: each knows what the other did, and takes over when it dies.

Those that share a folder are in `test_replicas_on_ray`.
"""

import contextlib
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room
from tests.service.storage.bucket_server import BUCKET, BucketServer

pytestmark = [
    pytest.mark.integration,
    pytest.mark.skipif(shutil.which("redis-server") is None, reason="needs redis-server from apt"),
]


@pytest.fixture(scope="module")
def replicas() -> Iterator[tuple[RunningService, RunningService]]:
    with RealRedis() as server, tempfile.TemporaryDirectory(prefix="pl-") as folder:
        bucket = BucketServer()
        settings = {"shared": "true", "redis_url": server.url, "storage": f"s3://{BUCKET}/panoloc"}
        first, second = (RunningService(Path(folder) / name, bucket.variables, **settings) for name in ("one", "two"))
        try:
            for replica in (first, second):
                replica.wait_until_ready()
            yield first, second
        finally:
            for replica in (first, second):
                replica.stop()
            bucket.stop()


Replicas = tuple[RunningService, RunningService]


def test_a_map_posted_through_one_is_served_by_the_other(replicas: Replicas) -> None:
    first, second = replicas
    map_id = first.register(small_room().scan, OPTIONS)
    assert second.map(map_id)["status"] == "ready"
    answer = second.localize(small_room().panorama, map_id)
    assert answer.status_code == 200, answer.text
    assert small_room().error_of(answer.json()).within(0.05, 5)


def test_no_process_shows_the_key_of_the_bucket(replicas: Replicas) -> None:
    for replica in replicas:
        family = replica.family()
        assert len(family) >= 2  # with its worker
        for pid in family:
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # ended meanwhile
                assert b"a-secret" not in Path(f"/proc/{pid}/environ").read_bytes()


def test_of_two_changes_at_once_one_wins_and_the_other_is_told(replicas: Replicas) -> None:
    (map_id,) = [each["id"] for each in replicas[0].http.get("/maps").json()["items"]]
    replaced = {"If-Match": f'"{replicas[0].map(map_id)["version"]}"'}

    def rename(replica: RunningService) -> int:
        name = {"name": f"of {replica.process.pid}"}
        return replica.http.patch(f"/maps/{map_id}", json=name, headers=replaced).status_code

    with ThreadPoolExecutor(2) as callers:
        assert sorted(callers.map(rename, replicas)) == [200, 412]
    assert replicas[0].map(map_id) == replicas[1].map(map_id)


def test_a_registration_whose_replica_is_killed_is_taken_over(replicas: Replicas) -> None:
    first, second = replicas
    answer = first.http.post("/maps", files={"file": ("room.ply", small_room().scan)}, data={"options": OPTIONS})
    map_id = answer.json()["id"]
    assert eventually(lambda: second.map(map_id)["status"] in ("reading", "indexing", "ready"), 120)
    os.kill(first.process.pid, signal.SIGKILL)
    first.process.wait()
    assert eventually(lambda: second.map(map_id)["status"] in ("ready", "failed"), 240)
    assert second.map(map_id)["status"] == "ready", second.map(map_id)
    assert second.localize(small_room().panorama, map_id).status_code == 200
