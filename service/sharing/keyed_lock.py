"""Work that is done to its end, and one after the other under the same key."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar
from weakref import WeakValueDictionary

Result = TypeVar("Result")


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
