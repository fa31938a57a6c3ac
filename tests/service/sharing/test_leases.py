"""Leases in Redis: one holder at a time, none for long after its process has ended, and no doubt that is not seen."""

import asyncio
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
import redis

from service.errors import CacheDownError
from service.host.embedded_redis import EmbeddedRedis
from service.host.lifeline import Lifeline
from service.sharing.leases import LeaseLocks

pytestmark = pytest.mark.anyio

LEASE_S = 0.6
KEY = "panoloc:lease:map-a"

_HOLDER = """
import asyncio, sys
from service.sharing.leases import LeaseLocks

async def hold():
    lock = await LeaseLocks(sys.argv[1], 1.0).try_hold("map-a")
    print(lock is not None, flush=True)
    await asyncio.sleep(600)

asyncio.run(hold())
"""


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="module")
def redis_url() -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        lifeline = Lifeline()
        server = EmbeddedRedis(Path(folder), lifeline, max_memory_bytes=64 * 2**20)
        server.start()
        yield server.url
        server.stop()
        lifeline.close()


@pytest.fixture
def client(redis_url: str) -> Iterator["redis.Redis"]:
    with redis.Redis.from_url(redis_url, decode_responses=True) as client:
        client.flushall()
        yield client


@pytest.fixture
async def both(
    redis_url: str, client: "redis.Redis", anyio_backend: str
) -> AsyncIterator[tuple[LeaseLocks, LeaseLocks]]:
    """Locks of two processes."""
    one, other = LeaseLocks(redis_url, LEASE_S), LeaseLocks(redis_url, LEASE_S)
    yield one, other
    for locks in (one, other):
        await locks.close()


Both = tuple[LeaseLocks, LeaseLocks]


@pytest.mark.slow
async def test_a_lease_has_one_holder_for_as_long_as_it_is_held(both: Both, client: "redis.Redis") -> None:
    one, other = both
    first = await one.try_hold("map-a")
    assert first is not None
    assert await one.try_hold("map-a") is None
    beside = await other.try_hold("map-b")
    assert beside is not None
    deadline = time.monotonic() + 4 * LEASE_S
    while time.monotonic() < deadline:
        assert await other.try_hold("map-a") is None
        assert one.is_sure("map-a")
        await asyncio.sleep(0.02)
    first.release()
    first.release()
    async with asyncio.timeout(LEASE_S / 2):
        async with other.held("map-a"):
            assert await one.try_hold("map-a") is None
    beside.release()
    await one.close()
    await other.close()
    assert client.keys("*") == []


@pytest.mark.slow
async def test_many_who_wait_are_inside_one_after_the_other(both: Both) -> None:
    inside, most = 0, 0

    async def enter(locks: LeaseLocks) -> None:
        nonlocal inside, most
        async with locks.held("map-a"):
            inside += 1
            most = max(most, inside)
            await asyncio.sleep(0.001)
            inside -= 1

    await asyncio.gather(*(enter(locks) for locks in both for _ in range(6)))
    assert most == 1


async def test_whoever_gives_up_waiting_leaves_the_lease_free(both: Both) -> None:
    for _ in range(20):
        trying = asyncio.create_task(both[0].try_hold("map-a"))
        await asyncio.sleep(0)
        trying.cancel()
        await asyncio.gather(trying, return_exceptions=True)
    async with asyncio.timeout(LEASE_S / 2), both[1].held("map-a"):
        pass


@pytest.mark.slow
async def test_a_killed_process_holds_nothing_for_long(redis_url: str, both: Both) -> None:
    command = [sys.executable, "-c", _HOLDER, redis_url]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"True\n"
        await asyncio.sleep(1.5)
        assert await both[0].try_hold("map-a") is None
        holder.kill()
        holder.wait()
    async with asyncio.timeout(10), both[0].held("map-a"):
        pass


@pytest.mark.slow
async def test_leases_come_back_after_redis_has_lost_them(both: Both, client: "redis.Redis") -> None:
    one, other = both
    assert await one.try_hold("map-a") is not None
    client.flushall()
    await asyncio.sleep(LEASE_S)
    assert await other.try_hold("map-a") is None
    assert one.is_sure("map-a")


async def test_a_holder_learns_that_another_has_its_lease_and_leaves_it_alone(
    both: Both, client: "redis.Redis"
) -> None:
    lock = await both[0].try_hold("map-a")
    assert lock is not None
    lost = asyncio.Event()
    lock.call_when_lost(lost.set)
    client.set(KEY, "of another", px=60_000)
    async with asyncio.timeout(10):
        await lost.wait()
    assert not both[0].is_sure("map-a")
    lock.release()
    await both[0].close()
    assert client.get(KEY) == "of another"


async def test_one_that_lets_go_late_leaves_the_lease_of_another_alone(both: Both, client: "redis.Redis") -> None:
    lock = await both[0].try_hold("map-a")
    assert lock is not None
    client.set(KEY, "of another", px=60_000)  # which this process has not heard of yet
    lock.release()
    await both[0].close()
    assert client.get(KEY) == "of another"


@pytest.mark.slow
async def test_a_lease_that_was_not_renewed_in_time_is_not_sure(both: Both) -> None:
    locks = both[0]
    lock = await locks.try_hold("map-a")
    assert lock is not None
    assert locks.is_sure("map-a")
    time.sleep(LEASE_S)  # this process stands still
    assert not locks.is_sure("map-a")
    assert locks.is_sure("map-b")
    await asyncio.sleep(LEASE_S)
    assert locks.is_sure("map-a")  # nobody has taken it: it is ours again
    lock.release()
    assert locks.is_sure("map-a")


async def test_a_redis_that_is_away_is_said(both: Both) -> None:
    locks = LeaseLocks("redis://127.0.0.1:1", LEASE_S)
    with pytest.raises(CacheDownError, match="expected a lock from Redis"):
        await locks.try_hold("map-a")
    with pytest.raises(CacheDownError):
        async with locks.held("map-a"):
            pass
    await locks.close()
