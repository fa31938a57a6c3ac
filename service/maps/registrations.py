"""Brings every uploaded scan to `ready` or `failed`: after an upload, and again after a restart.

One task per revision waits for the pool. A newer scan or the deletion of the map cancels it. Of several processes that
share the maps one owns the revision; when that ends in whatever way, another takes it over.
"""

import asyncio
import json
import time
from collections.abc import Callable, Coroutine
from typing import Any

import structlog

from panoloc.service.cache import Cache
from panoloc.service.errors import (
    EXPECTED_ERRORS,
    CacheDownError,
    MapNotFoundError,
    NoWorkerError,
    RegistrationLimitError,
    StorageFullError,
    StorageReadOnlyError,
    TryAgainError,
)
from panoloc.service.jobs import MapRef, RegisterJob, RegisterOutcome, WorkerPool
from panoloc.service.limits.registration_limits import MAX_ATTEMPTS, RegistrationLimits
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.metrics import Metrics
from panoloc.service.problems import problem_document
from panoloc.service.sharing.locks import uninterrupted

_log = structlog.get_logger(__name__)

_POLL_S = 0.1
_ROOM_PAUSE_S = 2.0
_LONGEST_PAUSE_S = 30.0
_NO_ROOM = "waiting for room on the disk"
_NO_STORAGE = "waiting for the storage"


class Registrations:
    """Used from one event loop. waiting_for_room: revisions that are done but cannot be stored, with the reason."""

    def __init__(
        self, registry: MapRegistry, pool: WorkerPool, cache: Cache, metrics: Metrics, limits: RegistrationLimits
    ) -> None:
        self._registry = registry
        self._pool = pool
        self._cache = cache
        self._metrics = metrics
        self._limits = limits
        self._stopping = False
        self._room_pause_s = _ROOM_PAUSE_S
        self.waiting_for_room: dict[MapRef, str] = {}
        self._running: dict[MapRef, asyncio.Task[None]] = {}

    def resume(self) -> None:
        """Begin again with every scan that has not come to an end and that no other process registers."""
        for record in self._registry.all():
            if record.newest.status == "queued":
                self.begin(record.newest_ref, request_id=f"resume-{record.id}")

    def begin(self, ref: MapRef, request_id: str) -> None:
        """Register a revision whose record and scan are stored; does nothing when that is under way."""
        if ref in self._running:
            return
        task = asyncio.create_task(self._run(ref, request_id), name=f"register {ref.id}")
        self._running[ref] = task
        task.add_done_callback(lambda ended: self._note_end(ref, ended))

    async def cancel(self, map_id: str, keep: MapRef | None = None) -> None:
        """End the registrations of a map, save that of `keep`, and wait until they have ended."""
        await _end([task for ref, task in self._running.items() if ref.id == map_id and ref != keep])

    async def end_unwanted(self) -> None:
        """End the registrations of revisions that other processes have replaced, or whose maps they have deleted."""
        await _end([task for ref, task in self._running.items() if not self._is_wanted(ref)])

    async def forget(self, ref: MapRef) -> None:
        """Remove a revision that its map names no more. A query that still holds it is sent to the new one."""
        if self._registry.holds(ref):
            return
        await self._registry.remove_revision(ref)
        try:
            await self._cache.forget_revision(ref)
        except CacheDownError as error:
            _log.warning("an old revision stays in Redis until its lifetime ends", error=str(error))

    async def stop(self) -> None:
        """End all registrations; their scans are taken up again at the next start."""
        self._stopping = True
        await _end(list(self._running.values()))

    def _note_end(self, ref: MapRef, task: asyncio.Task[None]) -> None:
        del self._running[ref]
        if task.cancelled():
            self._metrics.note_registration("cancelled")

    async def _run(self, ref: MapRef, request_id: str) -> None:
        structlog.contextvars.bind_contextvars(request_id=request_id, map_id=ref.id, revision=ref.revision)
        await self._wait_until_possible()
        try:
            own = await self._registry.try_register(ref)
        except (TryAgainError, OSError) as error:
            _log.warning("a registration cannot be resumed; the service retries later", error=str(error))
            return
        if own is None:
            return
        own.when_lost = self._running[ref].cancel
        try:
            # Another process may have brought it to its end before it was ours.
            await self._registry.refresh(ref.id)
            if not self._is_wanted(ref) or self._registry.get(ref.id).newest.status == "queued":
                await self._register(ref, request_id)
        except TryAgainError as error:
            _log.warning("a registration cannot continue; the service retries later", error=str(error))
        finally:
            own.release()

    def _is_wanted(self, ref: MapRef) -> bool:
        return self._registry.has(ref.id) and self._registry.get(ref.id).newest_ref == ref

    async def _register(self, ref: MapRef, request_id: str) -> None:
        began = time.monotonic()
        try:
            result = await self._result_of(ref, request_id)
        except MapNotFoundError:
            # Replaced or deleted: whoever did that is about to end this, but the work was faster.
            self._metrics.note_registration("cancelled")
            return
        duration_s = time.monotonic() - began
        self._metrics.note_registration(result, duration_s)
        _log.info("registration ended", result=result, duration_s=round(duration_s, 3))

    async def _result_of(self, ref: MapRef, request_id: str) -> str:
        """Return "ready" or "failed", the map's status now. Raises MapNotFoundError when nobody wants it any more."""
        try:
            outcome = await self._outcome_of(ref, request_id)
            await self._once_there_is_room(ref, lambda: self._finish(ref, outcome))
            return "ready"
        except MapNotFoundError:
            raise
        except Exception as error:
            if not isinstance(error, EXPECTED_ERRORS):
                _log.exception("a registration failed unexpectedly")
            if isinstance(error, RegistrationLimitError):
                self._metrics.note_refusal("registration")
            failure = problem_document(error, request_id)
            await self._once_there_is_room(
                ref, lambda: self._registry.change_newest(ref, status="failed", error=failure)
            )
            return "failed"

    async def _once_there_is_room(self, ref: MapRef, store: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Store the result of a registration; wait for as long as the storage takes nothing."""
        attempt = 1
        try:
            while True:
                try:
                    await uninterrupted(store())
                    return
                except TryAgainError as error:
                    has_no_room = isinstance(error, StorageFullError | StorageReadOnlyError)
                    self.waiting_for_room[ref] = _NO_ROOM if has_no_room else _NO_STORAGE
                    _log.warning("a map cannot be stored; the service retries", map_id=ref.id, error=str(error))
                await asyncio.sleep(min(self._room_pause_s * attempt, _LONGEST_PAUSE_S))
                attempt += 1
        finally:
            self.waiting_for_room.pop(ref, None)

    async def _outcome_of(self, ref: MapRef, request_id: str) -> RegisterOutcome:
        """Let a worker do it; what is only a matter of time is tried again, a few times."""
        while True:
            await self._wait_until_possible()
            newest = self._registry.get(ref.id).newest
            if newest.number != ref.revision:
                raise NoWorkerError(f"revision {ref.revision} was replaced by revision {newest.number}")
            time_limit_s = self._limits.seconds(newest.unpacked_bytes or newest.scan_bytes)
            job = RegisterJob(ref, newest.scan_key, newest.scan_name, newest.options, request_id, time_limit_s)
            try:
                return await self._pool.register(job, lambda: self._begin_attempt(ref))
            except TryAgainError as error:
                attempt = self._registry.get(ref.id).newest.num_attempts
                if attempt >= MAX_ATTEMPTS:
                    raise
                _log.warning("a registration is retried", attempt=attempt, error=str(error))
                await asyncio.sleep(min(error.retry_after_s * max(1, attempt), _LONGEST_PAUSE_S))
            except asyncio.CancelledError:
                # An orderly stop is no attempt that ended the service.
                if self._stopping and self._is_wanted(ref) and self._registry.get(ref.id).newest != newest:
                    await uninterrupted(self._registry.change_newest(ref, num_attempts=newest.num_attempts))
                raise

    async def _begin_attempt(self, ref: MapRef) -> None:
        """Count an attempt before it can end the service, so that a scan that always does is given up."""
        num_attempts = self._registry.get(ref.id).newest.num_attempts
        if num_attempts >= MAX_ATTEMPTS:
            raise RegistrationLimitError(
                f"expected a map after at most {MAX_ATTEMPTS} attempts, but the service ended during each of them; "
                "upload a smaller scan, or one in another format"
            )
        await self._registry.change_newest(ref, num_attempts=num_attempts + 1)

    async def _wait_until_possible(self) -> None:
        while True:
            try:
                if self._pool.state().ready:
                    await self._cache.check()
                    return
            except CacheDownError:
                await asyncio.sleep(_POLL_S)
            await asyncio.sleep(_POLL_S)

    async def _finish(self, ref: MapRef, outcome: RegisterOutcome) -> None:
        files = {
            "preview.png": outcome.preview_png,
            "points.ply": outcome.points_ply,
            "starts.json": json.dumps(outcome.starts).encode(),
        }
        await self._registry.put_files(ref, files)
        former = self._registry.get(ref.id).serving_ref
        await self._registry.change_newest(
            ref, status="ready", stats=outcome.stats, diagnostics=outcome.diagnostics, error=None
        )
        if former is not None:
            await self.forget(former)


async def _end(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
