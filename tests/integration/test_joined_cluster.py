"""A pool that joins a Ray cluster which somebody else runs, and leaves it as it was."""

import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.pool_in_thread import PoolInThread, query, registration
from tests.integration.ray_cluster import RayClusterOfOthers

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def cluster() -> Iterator[RayClusterOfOthers]:
    with RayClusterOfOthers() as cluster:
        yield cluster


@pytest.fixture
def cluster_address(cluster: RayClusterOfOthers) -> str:
    return cluster.address


def test_a_running_cluster_is_joined_used_and_left_running(cluster_address: str) -> None:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        running = PoolInThread(Path(folder), ray_address=cluster_address)
        try:
            running.wait_until_ready()
            pid = running.localize(query("joined")).answer.search["pid"]
            assert running.run(running.pool.register(registration("map_joined"))).stats["nice"] >= 10
        finally:
            running.stop()
    assert wait_until_gone(pid)
    host, _, port = cluster_address.rpartition(":")
    socket.create_connection((host, int(port)), 10).close()


def test_machines_that_cannot_reach_redis_are_named_until_they_can(cluster_address: str) -> None:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        running = PoolInThread(Path(folder), ray_address=cluster_address, redis_url="redis://127.0.0.1:1")
        try:
            deadline = time.monotonic() + 240
            while "Redis" not in (running.pool.state().waiting_for or "") and time.monotonic() < deadline:
                time.sleep(0.1)
            state = running.pool.state()
        finally:
            running.stop()
    assert not state.ready
    assert state.waiting_for is not None
    assert "expected an answer from Redis at redis://127.0.0.1:1" in state.waiting_for


def wait_until_gone(pid: int) -> bool:
    deadline = time.monotonic() + 90
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    return not Path(f"/proc/{pid}").exists()
