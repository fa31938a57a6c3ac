"""Locks that the API replicas on one storage hold one at a time, and locks within one process.

Replicas that share a folder lock files: the kernel drops the locks of a process that ends, at once and without a clock.
Several machines need a file system on which `flock` counts for all of them, as NFS 4, CephFS and Amazon EFS do.
Replicas that share a bucket hold leases in Redis, see `panoloc.service.sharing.leases`.
"""

import asyncio
import contextlib
import fcntl
import os
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar
from weakref import WeakValueDictionary

from panoloc.service.errors import CacheDownError
from panoloc.service.storage.disk import disk_errors

Result = TypeVar("Result")

_PAUSE_S = 0.005
_LONGEST_PAUSE_S = 0.1


@dataclass(eq=False)
class HeldLock:
    """A lock. release: lets others have it. when_lost: called when another process has it, which only leases allow."""

    release: Callable[[], None]
    when_lost: Callable[[], object] = lambda: None


class Locks(ABC):
    """Used from one event loop. is_shared: whether other processes use the same storage.

    Taking a lock raises StorageFullError, StorageReadOnlyError and CacheDownError.
    """

    is_shared = True

    async def try_hold(self, name: str) -> HeldLock | None:
        """Return the lock, None while somebody else holds it. name: of letters, digits, `-` and `_`."""
        trying = asyncio.ensure_future(self._try(name))
        try:
            return await asyncio.shield(trying)
        except asyncio.CancelledError:
            trying.add_done_callback(_release_found)
            raise

    @asynccontextmanager
    async def held(self, name: str) -> AsyncIterator[None]:
        """Wait for a lock and hold it for the duration of a block; for what takes moments."""
        # Not in a thread that sleeps until it has it: the holder may need a thread to get done.
        pause_s = _PAUSE_S
        while (lock := await self.try_hold(name)) is None:
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        try:
            yield
        finally:
            lock.release()

    def check_sure(self, name: str) -> None:
        """Raise CacheDownError where another process may have a lock of this one; before what cannot be undone."""
        if not self.is_sure(name):
            raise CacheDownError("expected the lock in Redis to be renewed in time, but it expired; try again")

    def is_sure(self, name: str) -> bool:
        """Tell whether a lock of this process is certainly still its own; True for one that it does not hold."""
        return True

    async def close(self) -> None:  # noqa: B027 - only leases have to be released
        """Release everything."""

    @abstractmethod
    async def _try(self, name: str) -> HeldLock | None:
        """Return the lock, None while somebody else holds it; is never cancelled."""


class OwnLocks(Locks):
    """Of the only process on a storage: nothing is written, and `held` does not wait."""

    is_shared = False

    def __init__(self) -> None:
        self._held: set[str] = set()

    @asynccontextmanager
    async def held(self, name: str) -> AsyncIterator[None]:
        """Go on at once: callers exclude each other within their process themselves."""
        yield

    async def _try(self, name: str) -> HeldLock | None:
        if name in self._held:
            return None
        self._held.add(name)
        return HeldLock(lambda: self._held.discard(name))


class FolderLocks(Locks):
    """Of processes that share a folder. folder: for the files of the locks, made when the first one is taken."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    async def _try(self, name: str) -> HeldLock | None:
        return await asyncio.to_thread(self._try_file, self._folder / name)

    def _try_file(self, path: Path) -> HeldLock | None:
        while True:
            with disk_errors():
                self._folder.mkdir(parents=True, exist_ok=True)
                # Not inherited by child processes, which would hold it after us.
                file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(file)
                return None
            if os.fstat(file).st_nlink:
                return HeldLock(partial(_remove, file, path))
            # Removed by the holder before us, between our opening and our locking.
            os.close(file)


def _remove(file: int, path: Path) -> None:
    # While it is still locked: otherwise this could remove the file that somebody else has just locked.
    with contextlib.suppress(OSError):
        path.unlink()
    os.close(file)


def _release_found(trying: asyncio.Future[HeldLock | None]) -> None:
    if not trying.cancelled() and trying.exception() is None and (lock := trying.result()) is not None:
        lock.release()


async def uninterrupted(work: Awaitable[Result]) -> Result:
    """Wait for work that must not stop half-way; cancellations, of which several may come, take effect after it."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is not None:
        raise cancelled from task.exception()
    return task.result()


class KeyedLock:
    """Runs work under one key one after the other; different keys do not wait. Used from one event loop."""

    def __init__(self) -> None:
        # Each lives for as long as somebody holds it or waits for it.
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def run(self, key: str, work: Callable[[], Awaitable[Result]]) -> Result:
        """Run work under a key, to its end also when the caller is cancelled."""
        lock = self._locks.setdefault(key, asyncio.Lock())

        async def locked() -> Result:
            async with lock:
                return await work()

        return await uninterrupted(locked())
