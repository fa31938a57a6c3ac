"""Locks of one folder: one holder at a time, and none after its process has ended."""

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest

from service.errors import StorageReadOnlyError
from service.sharing.folder_locks import OwnFolderLocks, SharedFolderLocks

_HOLDER = """
import asyncio, pathlib, sys
from service.sharing.folder_locks import SharedFolderLocks
lock = asyncio.run(SharedFolderLocks(pathlib.Path(sys.argv[1])).try_hold("map-a"))
print(lock is not None, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("is_shared", [True, False])
def test_a_lock_has_one_holder_until_it_is_released(tmp_path: Path, is_shared: bool) -> None:
    async def take_turns() -> list[bool]:
        one = SharedFolderLocks(tmp_path) if is_shared else OwnFolderLocks()
        other = SharedFolderLocks(tmp_path) if is_shared else one
        first = await one.try_hold("map-a")
        assert first is not None
        found = [await other.try_hold("map-a") is not None]
        beside = await other.try_hold("map-b")
        assert beside is not None
        beside.release()
        first.release()
        second = await other.try_hold("map-a")
        assert second is not None
        second.release()
        return found

    assert asyncio.run(take_turns()) == [False]


@pytest.mark.slow
def test_many_who_wait_are_inside_one_after_the_other(tmp_path: Path) -> None:
    inside, most = 0, 0

    async def enter() -> None:
        nonlocal inside, most
        async with SharedFolderLocks(tmp_path).held("map-a"):
            inside += 1
            most = max(most, inside)
            await asyncio.sleep(0.001)
            inside -= 1

    async def enter_all() -> None:
        await asyncio.gather(*(enter() for _ in range(12)))

    asyncio.run(enter_all())
    assert most == 1
    assert list(tmp_path.iterdir()) == []


def test_whoever_gives_up_waiting_leaves_the_lock_free(tmp_path: Path) -> None:
    async def give_up() -> None:
        locks = SharedFolderLocks(tmp_path)
        for _ in range(20):
            trying = asyncio.create_task(locks.try_hold("map-a"))
            await asyncio.sleep(0)
            trying.cancel()
            await asyncio.gather(trying, return_exceptions=True)
        async with asyncio.timeout(90):
            async with locks.held("map-a"):
                pass

    asyncio.run(give_up())


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"True\n"
        assert asyncio.run(SharedFolderLocks(tmp_path).try_hold("map-a")) is None
        holder.kill()
        holder.wait()
    lock = asyncio.run(SharedFolderLocks(tmp_path).try_hold("map-a"))
    assert lock is not None
    lock.release()


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(StorageReadOnlyError):
        asyncio.run(SharedFolderLocks(tmp_path / "locks").try_hold("map-a"))
