"""A pool that joins a Ray cluster which somebody else runs, and leaves it as it was."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import ray

from service.host.process_tree import descendants
from tests.integration.pool_in_thread import PoolInThread, query, registration
from tests.integration.running_service import eventually

pytestmark = pytest.mark.integration
RUNS = b"will now block forever"


@pytest.fixture(scope="module")
def cluster_address() -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("", 0))
        address = f"{ray.util.get_node_ip_address()}:{probe.getsockname()[1]}"
    with tempfile.TemporaryDirectory(prefix="pl-", ignore_cleanup_errors=True) as folder:
        command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--block", "--num-cpus=4",
                   "--include-dashboard=false", "--object-store-memory=80000000", "--node-ip-address=127.0.0.1",
                   f"--port={address.rpartition(':')[2]}", f"--temp-dir={folder}"]  # fmt: skip
        head = started_head(command, Path(folder) / "head.log")
        try:
            wait_for_port(address)
            yield address
        finally:
            end(head)


def started_head(command: list[str], log: Path) -> "subprocess.Popen[bytes]":
    """Return the head of a cluster once it runs. It gives its raylet 30 s, which on a busy machine is too little, so it is tried again."""
    environment = os.environ | {"RAY_USAGE_STATS_ENABLED": "0"}
    for _ in range(5):
        with log.open("wb") as out:
            head = subprocess.Popen(command, stdout=out, stderr=out, env=environment)
        eventually(lambda tried=head: tried.poll() is not None or RUNS in log.read_bytes(), 240)  # type: ignore[misc]
        if head.poll() is None and RUNS in log.read_bytes():
            return head
        end(head)
    raise AssertionError(log.read_text(errors="replace")[-3000:])


def end(head: "subprocess.Popen[bytes]") -> None:
    """Kill the head and all that it has started."""
    family = descendants(head.pid)
    head.kill()
    head.wait()
    for pid in family:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def wait_for_port(address: str) -> None:
    host, _, port = address.rpartition(":")
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        with socket.socket() as client:
            if client.connect_ex((host, int(port))) == 0:
                return
        time.sleep(0.1)
    raise AssertionError(f"no Ray at {address}")


def test_a_running_cluster_is_joined_used_and_left_running(cluster_address: str) -> None:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        running = PoolInThread(Path(folder), ray_address=cluster_address)
        try:
            running.wait_until_ready()
            pid = running.localize(query("joined")).search["pid"]
            assert running.run(running.pool.register(registration("map_joined"))).stats["nice"] >= 10
        finally:
            running.stop()
    assert wait_until_gone(pid)
    wait_for_port(cluster_address)


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
