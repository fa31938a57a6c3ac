"""What is done to one map is done one after the other; different maps do not wait for each other."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar
from weakref import WeakValueDictionary

from service.sharing.locks import Locks

Result = TypeVar("Result")


class Turns:
    """Used from one event loop. locks: of the processes that use the same maps."""

    def __init__(self, locks: Locks) -> None:
        self._locks = locks
        # Each lives for as long as somebody holds it or waits for it.
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._under_way: set[asyncio.Task[Any]] = set()

    async def take(self, map_id: str, lock: str, work: Coroutine[Any, Any, Result]) -> Result:
        """Do something to a map, to its end even when the caller goes away: memory and storage agree. lock: of the map, among processes."""

        async def among_all() -> Result:
            try:
                async with self._locks.held(lock):
                    return await work
            finally:
                work.close()  # where it has not begun

        return await self.take_here(map_id, among_all())

    async def take_here(self, map_id: str, work: Coroutine[Any, Any, Result]) -> Result:
        """The same, but only in turn with what this process does: for what changes nothing that is stored."""
        turn = self._turns.setdefault(map_id, asyncio.Lock())

        async def in_turn() -> Result:
            async with turn:
                return await work

        task = asyncio.create_task(in_turn())
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        return await asyncio.shield(task)
