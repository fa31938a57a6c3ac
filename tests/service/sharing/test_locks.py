"""Locks of API replicas: one holder at a time, none for long after its process has ended, and every doubt is seen."""

import asyncio
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
import redis

from panoloc.service.errors import CacheDownError, StorageReadOnlyError
from panoloc.service.sharing.leases import LeaseLocks
from panoloc.service.sharing.locks import FolderLocks, HeldLock, Locks, OwnLocks

pytestmark = pytest.mark.anyio

LEASE_S = 0.4
KEY = "panoloc:lease:map-a"

_HOLDER = """
import asyncio, pathlib, sys
from panoloc.service.sharing.leases import LeaseLocks
from panoloc.service.sharing.locks import FolderLocks

async def hold():
    where = sys.argv[1]
    locks = LeaseLocks(where, 1.0) if where.startswith("unix") else FolderLocks(pathlib.Path(where))
    print(await locks.try_hold("map-a") is not None, flush=True)
    await asyncio.sleep(600)

asyncio.run(hold())
"""


Both = tuple[Locks, Locks]


@pytest.fixture
async def leases(redis_url: str, anyio_backend: str) -> AsyncIterator[Both]:
    """Leases of two processes."""
    one, other = LeaseLocks(redis_url, LEASE_S), LeaseLocks(redis_url, LEASE_S)
    yield one, other
    for locks in (one, other):
        await locks.close()


@pytest.fixture(params=["folder", "leases"])
def both(request: pytest.FixtureRequest, tmp_path: Path, leases: Both) -> Both:
    """Locks of two processes."""
    return leases if request.param == "leases" else (FolderLocks(tmp_path), FolderLocks(tmp_path))


async def taken(locks: Locks, name: str = "map-a") -> HeldLock:
    lock = await locks.try_hold(name)
    assert lock is not None
    return lock


@pytest.mark.slow
async def test_a_lock_has_one_holder_for_as_long_as_it_is_held(
    both: Both, redis_client: "redis.Redis", tmp_path: Path
) -> None:
    one, other = both
    first = await taken(one)
    assert await one.try_hold("map-a") is None
    beside = await taken(other, "map-b")
    deadline = time.monotonic() + (3 * LEASE_S if isinstance(one, LeaseLocks) else 0.0)
    while time.monotonic() < deadline:
        assert await other.try_hold("map-a") is None
        assert one.is_sure("map-a")
        await asyncio.sleep(0.02)
    first.release()
    async with asyncio.timeout(LEASE_S / 2), other.held("map-a"):
        assert await one.try_hold("map-a") is None
    beside.release()
    for locks in both:
        await locks.close()
    assert redis_client.keys("*") == []
    assert list(tmp_path.iterdir()) == []


async def test_a_process_alone_excludes_itself() -> None:
    locks = OwnLocks()
    lock = await taken(locks)
    assert await locks.try_hold("map-a") is None
    lock.release()
    await taken(locks)


async def test_many_that_wait_are_inside_one_after_the_other(both: Both) -> None:
    inside, most = 0, 0

    async def enter(locks: Locks) -> None:
        nonlocal inside, most
        async with locks.held("map-a"):
            inside += 1
            most = max(most, inside)
            await asyncio.sleep(0.001)
            inside -= 1

    await asyncio.gather(*(enter(locks) for locks in both for _ in range(6)))
    assert most == 1


async def test_a_caller_that_gives_up_waiting_leaves_the_lock_free(both: Both) -> None:
    for _ in range(20):
        trying = asyncio.create_task(both[0].try_hold("map-a"))
        await asyncio.sleep(0)
        trying.cancel()
        await asyncio.gather(trying, return_exceptions=True)
    async with asyncio.timeout(90), both[1].held("map-a"):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("both", ["folder", "leases"], indirect=True)
async def test_a_killed_process_holds_nothing_for_long(
    both: Both, tmp_path: Path, redis_url: str, redis_client: "redis.Redis"
) -> None:
    is_lease = isinstance(both[0], LeaseLocks)
    command = [sys.executable, "-c", _HOLDER, redis_url if is_lease else str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"True\n"
        if is_lease:  # it is renewed
            assert await until(lambda: 0 < redis_client.pttl(KEY) < 900)
            assert await until(lambda: redis_client.pttl(KEY) > 900)
        assert await both[0].try_hold("map-a") is None
        holder.kill()
        holder.wait()
    async with asyncio.timeout(10 if is_lease else 1), both[0].held("map-a"):
        pass


async def until(holds: Callable[[], bool]) -> bool:
    async with asyncio.timeout(60):
        while not holds():
            await asyncio.sleep(0.01)
    return True


async def test_leases_come_back_after_redis_has_lost_them(leases: Both, redis_client: "redis.Redis") -> None:
    one, other = leases
    await taken(one)
    redis_client.flushall()
    assert await until(lambda: bool(redis_client.exists(KEY)))
    assert await other.try_hold("map-a") is None
    assert one.is_sure("map-a")


async def test_a_holder_learns_that_another_has_its_lease_and_leaves_it_alone(
    leases: Both, redis_client: "redis.Redis"
) -> None:
    lock = await taken(leases[0])
    lost = asyncio.Event()
    lock.when_lost = lost.set
    redis_client.set(KEY, "of another", px=60_000)
    async with asyncio.timeout(10):
        await lost.wait()
    assert not leases[0].is_sure("map-a")
    lock.release()
    await leases[0].close()
    assert redis_client.get(KEY) == "of another"


async def test_a_holder_that_releases_late_leaves_the_lease_of_another_alone(
    leases: Both, redis_client: "redis.Redis"
) -> None:
    lock = await taken(leases[0])
    redis_client.set(KEY, "of another", px=60_000)  # which this process does not know yet
    lock.release()
    await leases[0].close()
    assert redis_client.get(KEY) == "of another"


async def test_a_lease_that_was_not_renewed_in_time_is_not_sure(leases: Both) -> None:
    locks = leases[0]
    lock = await taken(locks)
    assert locks.is_sure("map-a")
    time.sleep(LEASE_S)  # this process stands still
    assert not locks.is_sure("map-a")
    with pytest.raises(CacheDownError, match="renewed in time"):
        locks.check_sure("map-a")
    locks.check_sure("map-b")
    assert await until(lambda: locks.is_sure("map-a"))  # nobody has taken it
    lock.release()
    locks.check_sure("map-a")


async def test_a_redis_that_does_not_answer_is_reported() -> None:
    locks = LeaseLocks("redis://127.0.0.1:1", LEASE_S)
    with pytest.raises(CacheDownError, match="expected a lock from Redis"):
        await locks.try_hold("map-a")
    with pytest.raises(CacheDownError):
        async with locks.held("map-a"):
            pass
    await locks.close()


async def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(StorageReadOnlyError):
        await FolderLocks(tmp_path / "locks").try_hold("map-a")
