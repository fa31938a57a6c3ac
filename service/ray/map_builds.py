"""Registrations and rebuilds of map indexes: a few at a time, the same one never twice at once."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from service.errors import NoWorkerError, RegistrationLimitError
from service.jobs import MapRef, RegisterJob, RegisterOutcome, at_once
from service.worker.reply import WorkerReply, error_of

# Starts a task of `service.ray.remote` in a process of its own and returns its object reference.
Submit = Callable[..., Awaitable[Any]]
Begin = Callable[[], Awaitable[None]]


class MapBuilds:
    """Used from one event loop."""

    def __init__(self, submit: Submit, num_registrations: int) -> None:
        self._submit = submit
        self._registrations = asyncio.Semaphore(num_registrations)
        # A place of its own: a query that waits for a lost index does not wait for somebody's large scan as well.
        self._rebuild_place = asyncio.Semaphore(1)
        self._rebuilds: dict[MapRef, asyncio.Task[WorkerReply[None]]] = {}
        # Tasks that somebody gave up while they were handed to Ray: they are ended as soon as there is something to end.
        self._abandoned: set[asyncio.Future[Any]] = set()

    async def register(self, job: RegisterJob, begin: Begin = at_once) -> WorkerReply[RegisterOutcome]:
        """Run one registration after those that came before it, `begin` first.

        Raises NoWorkerError when its process keeps dying, RegistrationLimitError when it takes longer than its job allows.
        """
        from service.ray.remote import register_map

        async with self._registrations:
            await begin()
            try:
                async with asyncio.timeout(job.time_limit_s) as limit:
                    reply: WorkerReply[RegisterOutcome] = await self._finished(register_map, job)
                    return reply
            except TimeoutError as error:
                if not limit.expired():
                    raise
                raise RegistrationLimitError(
                    f"expected a map within {job.time_limit_s:.0f} s, got none; thin the "
                    "scan or export it in another format"
                ) from error

    async def rebuild(self, maps: Iterable[MapRef]) -> None:
        """Wait until the lost indexes of `maps` are built; queries that miss the same one wait for the same build.

        A build goes on when the query that asked for it gives up. Raises what the worker raised.
        """
        waiting = [asyncio.shield(self._running_rebuild(map_ref)) for map_ref in maps]
        for reply in await asyncio.gather(*waiting):
            if reply.failure is not None:
                raise error_of(reply.failure)

    async def cancel(self) -> None:
        """End the rebuilds under way; what they would have built is built when it is asked for again."""
        running = list(self._rebuilds.values())
        for task in running:
            task.cancel()
        await asyncio.gather(*running, *self._abandoned, return_exceptions=True)

    def _running_rebuild(self, map_ref: MapRef) -> asyncio.Task[WorkerReply[None]]:
        running = self._rebuilds.get(map_ref)
        if running is None:
            running = asyncio.create_task(self._rebuild(map_ref))
            self._rebuilds[map_ref] = running
            running.add_done_callback(lambda _: self._rebuilds.pop(map_ref, None))
        return running

    async def _rebuild(self, map_ref: MapRef) -> WorkerReply[None]:
        from service.ray.remote import rebuild_map

        async with self._rebuild_place:
            reply: WorkerReply[None] = await self._finished(rebuild_map, map_ref)
            return reply

    async def _submitted(self, task: Callable[..., Any], *arguments: Any) -> Any:
        """Return the reference of a task. One that was given up before it had a reference must not run on unseen."""
        submission = asyncio.ensure_future(self._submit(task, *arguments))
        try:
            return await asyncio.shield(submission)
        except asyncio.CancelledError:
            self._abandoned.add(submission)
            submission.add_done_callback(self._end_abandoned)
            raise

    def _end_abandoned(self, submission: asyncio.Future[Any]) -> None:
        import ray
        from ray.exceptions import RayError

        self._abandoned.discard(submission)
        if not submission.cancelled() and submission.exception() is None:
            with contextlib.suppress(RayError):
                ray.cancel(submission.result(), force=True)

    async def _finished(self, task: Callable[..., Any], *arguments: Any) -> Any:
        import ray
        from ray.exceptions import LocalRayletDiedError, NodeDiedError, OutOfMemoryError, RayError, WorkerCrashedError

        reference = await self._submitted(task, *arguments)
        try:
            return await reference
        except asyncio.CancelledError:
            with contextlib.suppress(RayError):  # of a cluster that was left there is nothing to end
                ray.cancel(reference, force=True)
            raise
        except (WorkerCrashedError, OutOfMemoryError) as error:
            raise NoWorkerError(
                f"the process that builds the map ended {type(error).__name__}: too little memory for this scan?"
            ) from error
        except (LocalRayletDiedError, NodeDiedError) as error:
            # Not the scan's fault: it is built again, if need be by the next service.
            raise NoWorkerError(f"the machine's Ray ended while it built the map ({type(error).__name__})") from error
