"""Locks that the front doors on one data folder hold one at a time.

A lock is a file that the kernel locks: whatever ends a process drops what it holds, at once and without a clock, and whoever looks next
takes over. Several machines need a file system on which `flock` counts for all of them, as NFS 4, CephFS and Amazon EFS are.
"""

import asyncio
import contextlib
import fcntl
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Protocol

from service.errors import CacheDownError
from service.sharing.held_lock import HeldLock, held_once_free, unless_cancelled
from service.storage.disk import disk_errors


class FolderLocks(Protocol):
    """Used from one event loop. is_shared: whether other processes use the same folder."""

    is_shared: bool

    async def try_hold(self, name: str) -> HeldLock | None:
        """Return the lock, None while somebody else holds it. name: of letters, digits, `-` and `_`.

        Raises StorageFullError, StorageReadOnlyError and CacheDownError.
        """

    def held(self, name: str) -> contextlib.AbstractAsyncContextManager[None]:
        """Wait for a lock and hold it for the duration of a block; for what takes moments. Raises as `try_hold` does."""

    def is_sure(self, name: str) -> bool:
        """Tell whether a lock that this process holds is its own beyond doubt, before what cannot be undone; True for one that it does
        not hold."""

    async def close(self) -> None:
        """Let go of everything."""


def check_sure(locks: FolderLocks, name: str) -> None:
    """Raise CacheDownError where another process may hold a lock that this one took; before what cannot be undone."""
    if not locks.is_sure(name):
        raise CacheDownError("expected a lock in Redis that is renewed in time, but it was not; try again")


class OwnFolderLocks:
    """Of a process that has the folder to itself: nothing is written, and what only processes could do to each other is not waited for."""

    is_shared = False

    def __init__(self) -> None:
        self._held: set[str] = set()

    async def try_hold(self, name: str) -> HeldLock | None:
        """Return the lock, None while it is held."""
        if name in self._held:
            return None
        self._held.add(name)
        return HeldLock(lambda: self._held.discard(name))

    @asynccontextmanager
    async def held(self, name: str) -> AsyncIterator[None]:
        """Go on at once: those who call this take turns within their process themselves."""
        yield

    def is_sure(self, name: str) -> bool:
        """Return True: there is nobody else."""
        return True

    async def close(self) -> None:
        """Do nothing: there is nobody else."""


class SharedFolderLocks:
    """Of processes that share a folder; the files of the locks lie in it."""

    is_shared = True

    def __init__(self, folder: Path) -> None:
        """folder: for the files, made when the first lock is taken."""
        self._folder = folder

    async def try_hold(self, name: str) -> HeldLock | None:
        """Return the lock, None while somebody else holds it."""
        return await unless_cancelled(asyncio.to_thread(self._try, name))

    def held(self, name: str) -> contextlib.AbstractAsyncContextManager[None]:
        """Wait for a lock and hold it for the duration of a block."""
        return held_once_free(self.try_hold, name)

    def is_sure(self, name: str) -> bool:
        """Return True: the kernel keeps a lock for as long as its holder lives."""
        return True

    async def close(self) -> None:
        """Do nothing: the kernel drops what this process holds when it ends."""

    def _try(self, name: str) -> HeldLock | None:
        path = self._folder / name
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
            if _is_same_file(file, path):
                return HeldLock(partial(_let_go, file, path))
            # Removed by the holder before us, between our opening and our locking.
            os.close(file)


def _let_go(file: int, path: Path) -> None:
    # While it is still held: a file that somebody waits for would otherwise be removed under him.
    with contextlib.suppress(OSError):
        path.unlink()
    os.close(file)


def _is_same_file(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False
