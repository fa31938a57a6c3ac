"""A Ray of our own listens to this machine alone, whatever address the machine has."""

import contextlib
import socket
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from service.host.lifeline import Lifeline
from service.ray.cluster import RayCluster

pytestmark = pytest.mark.integration

LISTENING = "0A"


@pytest.fixture
def cluster() -> Iterator[RayCluster]:
    with tempfile.TemporaryDirectory(prefix="pl-", dir="/tmp", ignore_cleanup_errors=True) as folder:
        lifeline = Lifeline()
        cluster = RayCluster(None, Path(folder), lifeline)
        with ThreadPoolExecutor(1) as thread:
            thread.submit(cluster.connect).result()
            try:
                yield cluster
            finally:
                thread.submit(cluster.disconnect).result()
        lifeline.close()


def addresses_of(pids: set[int]) -> list[str]:
    """Return the addresses on which processes listen, as the kernel knows them."""
    sockets = set()
    for link in (link for pid in pids for link in Path(f"/proc/{pid}/fd").iterdir()):
        with contextlib.suppress(FileNotFoundError):  # closed since
            sockets.add(str(link.readlink()).removeprefix("socket:[").removesuffix("]"))
    found = []
    for family, table in ((socket.AF_INET, "tcp"), (socket.AF_INET6, "tcp6")):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            (
                _,
                local,
                _,
                state,
                *_,
            ) = line.split()[:4]
            if state == LISTENING and line.split()[9] in sockets:
                words = bytes.fromhex(local.partition(":")[0])
                address = b"".join(words[at : at + 4][::-1] for at in range(0, len(words), 4))
                found.append(socket.inet_ntop(family, address))
    return found


def test_nothing_of_ray_listens_beyond_this_machine(cluster: RayCluster) -> None:
    found = addresses_of(set(cluster._guarded))
    assert found
    assert set(found) <= {"127.0.0.1", "::1", "::ffff:127.0.0.1"}
