"""What the locks of front doors have in common: how they are held, waited for and let go."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

_PAUSE_S = 0.005
_LONGEST_PAUSE_S = 0.1


class HeldLock:
    """A lock until it is released, or lost to another process, as only leases are."""

    def __init__(self, release: Callable[[], None]) -> None:
        self._release = release
        self._when_lost: Callable[[], object] = lambda: None

    def release(self) -> None:
        """Let others have it."""
        self._release()

    def call_when_lost(self, end: Callable[[], object]) -> None:
        """Name what ends the work under this lock when another process has it."""
        self._when_lost = end

    def lose(self) -> None:
        """Say that another process has it."""
        self._when_lost()


async def unless_cancelled(trying: Coroutine[Any, Any, HeldLock | None]) -> HeldLock | None:
    """Return the lock that is found, if any; one that is found after nobody wants it any more is released."""
    task = asyncio.ensure_future(trying)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        task.add_done_callback(_release_found)
        raise


@asynccontextmanager
async def held_once_free(try_hold: Callable[[str], Awaitable[HeldLock | None]], name: str) -> AsyncIterator[None]:
    """Try again and again to hold a lock, and hold it for the duration of a block."""
    # Not in a thread that sleeps until it has it: who holds the lock may need a thread to get done.
    pause_s = _PAUSE_S
    while (lock := await try_hold(name)) is None:
        await asyncio.sleep(pause_s)
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
    try:
        yield
    finally:
        lock.release()


def _release_found(trying: asyncio.Future[HeldLock | None]) -> None:
    if not trying.cancelled() and trying.exception() is None and (lock := trying.result()) is not None:
        lock.release()
