"""Registrations and rebuilds of map indexes: a few at a time, and never the same rebuild twice at once."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

from panoloc.service.errors import NoWorkerError, RegistrationLimitError
from panoloc.service.jobs import MapRef, RegisterJob, RegisterOutcome, at_once
from panoloc.service.pool.messages import Build
from panoloc.service.worker.plan import WorkerReply, error_of


class MapBuilds:
    """Used from one event loop."""

    def __init__(self, build: Callable[[Build], Awaitable[WorkerReply[Any]]], num_registrations: int) -> None:
        """build: see `panoloc.service.pool.worker_process.run_build`."""
        self._build = build
        self._registrations = asyncio.Semaphore(num_registrations)
        # A rebuild has a place of its own: a query that needs it does not wait for somebody's large scan.
        self._rebuild_place = asyncio.Semaphore(1)
        self._rebuilds: dict[MapRef, asyncio.Task[WorkerReply[None]]] = {}

    async def register(
        self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once
    ) -> WorkerReply[RegisterOutcome]:
        """Run one registration after those that came before it, `begin` first.

        Raises NoWorkerError when its process dies, RegistrationLimitError when it takes longer than the job allows.
        """
        async with self._registrations:
            await begin()
            too_long = RegistrationLimitError(
                f"expected a map within {job.time_limit_s or 0:.0f} s, got none; thin the scan or export it in another format"
            )
            async with time_limit(job.time_limit_s, too_long):
                return await self._build(job)

    async def rebuild(self, maps: Sequence[MapRef]) -> dict[MapRef, Exception]:
        """Wait until the lost indexes of `maps` are built; queries that miss the same one wait for the same build.

        A build goes on when the query that asked for it gives up. Returns what workers raised, for the maps that cannot be built.
        """
        waiting = [asyncio.shield(self._running_rebuild(map_ref)) for map_ref in maps]
        replies = zip(maps, await asyncio.gather(*waiting), strict=True)
        return {map_ref: error_of(reply.failure) for map_ref, reply in replies if reply.failure is not None}

    async def cancel(self) -> None:
        """End the rebuilds under way; the next query that misses such an index asks for it again."""
        running = list(self._rebuilds.values())
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    def _running_rebuild(self, map_ref: MapRef) -> asyncio.Task[WorkerReply[None]]:
        running = self._rebuilds.get(map_ref)
        if running is None:
            running = asyncio.create_task(self._rebuild(map_ref))
            self._rebuilds[map_ref] = running
            running.add_done_callback(lambda _: self._rebuilds.pop(map_ref, None))
        return running

    async def _rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        async with self._rebuild_place:
            try:
                return await self._build(map_ref)
            except NoWorkerError:
                return await self._build(map_ref)


@asynccontextmanager
async def time_limit(seconds: float | None, error: Exception) -> AsyncIterator[None]:
    """Raise `error` when the block takes longer than so many seconds; None: no limit."""
    try:
        async with asyncio.timeout(seconds) as limit:
            yield
    except TimeoutError as expired:
        if not limit.expired():
            raise
        raise error from expired
