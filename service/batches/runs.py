"""Brings every image of every batch to a result: after an upload, and again after a restart.

The pool gets one image per free worker, and only while no query waits: a batch of a thousand images delays a query by
no more than the image under way. Batches alternate. Of several processes that share the batches one owns a batch; when
that ends, another takes it over.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from typing import Any, TypeVar

import structlog

from panoloc.core.errors import DeadlineExceededError
from panoloc.core.image.image_header import IMAGE, open_image
from panoloc.service.batches.record import BatchRecord, image_key
from panoloc.service.batches.store import BatchStore
from panoloc.service.errors import (
    EXPECTED_ERRORS,
    CacheDownError,
    LocalizationNotFoundError,
    StorageAwayError,
    TryAgainError,
)
from panoloc.service.jobs import QueryImage, Result, WorkerPool
from panoloc.service.localizations import Localizations, LocalizeRequest
from panoloc.service.maps.selection import MapChoice
from panoloc.service.problems import problem_document

_log = structlog.get_logger(__name__)

_T = TypeVar("_T")

_POLL_S = 0.02
_FIRST_PAUSE_S = 1.0
_LONGEST_PAUSE_S = 10.0
_MAX_DEADLINES = 3
_MAX_READS = 4  # of an image; one that never can be read must not hold up the others


class BatchRuns:
    """Used from one event loop."""

    def __init__(self, store: BatchStore, localizations: Localizations, pool: WorkerPool, max_pixels: int) -> None:
        self._store = store
        self._localizations = localizations
        self._pool = pool
        self._max_pixels = max_pixels
        self._waiting = asyncio.Lock()
        self._num_under_way = 0
        self._running: dict[str, asyncio.Task[None]] = {}
        self._once_more: dict[str, BatchRecord] = {}
        store.redo = self.begin

    def resume(self) -> None:
        """Begin again with every batch that has not come to its end and that no other process works on."""
        for record in self._store.unfinished():
            if record.id not in self._running:
                self.begin(record)

    async def end_unwanted(self) -> None:
        """End the work on batches that other processes have deleted."""
        for batch_id in list(self._running):
            if not self._store.has(batch_id):
                await self.cancel(batch_id)

    def begin(self, record: BatchRecord) -> None:
        """Work on a stored batch; on one that is under way once more after its end."""
        if record.id in self._running:
            self._once_more[record.id] = record
            return
        task = asyncio.create_task(self._run(record), name=f"batch {record.id}")
        self._running[record.id] = task
        task.add_done_callback(lambda ended: self._note_end(record.id, ended))

    async def cancel(self, batch_id: str) -> None:
        """End the work on a batch and wait until it has ended."""
        self._once_more.pop(batch_id, None)
        task = self._running.get(batch_id)
        if task is not None:
            task.cancel()
            await asyncio.wait({task})

    async def stop(self) -> None:
        """End all work; what is not done is taken up again at the next start."""
        for batch_id in list(self._running):
            await self.cancel(batch_id)

    def _note_end(self, batch_id: str, task: asyncio.Task[None]) -> None:
        del self._running[batch_id]
        if not task.cancelled() and task.exception() is not None:
            _log.error("a batch failed unexpectedly", batch_id=batch_id, exc_info=task.exception())
        record = self._once_more.pop(batch_id, None)
        if record is not None:
            self.begin(record)

    async def _run(self, record: BatchRecord) -> None:
        structlog.contextvars.bind_contextvars(batch_id=record.id)
        while not self._pool.state().ready:
            await asyncio.sleep(_POLL_S)
        own = await _persistently(lambda: self._store.try_run(record.id), "a batch cannot be resumed")
        if own is None:
            return
        own.when_lost = self._running[record.id].cancel
        try:
            await self._run_own(record)
        finally:
            own.release()

    async def _run_own(self, record: BatchRecord) -> None:
        done = await _persistently(
            lambda: self._store.done(record.id), "the finished images of a batch cannot be listed"
        )
        if len(done) == len(record.names):
            return  # another process has done it meanwhile
        async with asyncio.TaskGroup() as images:
            for number in range(len(record.names)):
                if number not in done:
                    await self._wait_for_place()
                    image = images.create_task(self._localize(record, number))
                    # Also of one that is cancelled before it begins.
                    image.add_done_callback(self._release)
        _log.info("a batch is done", num_images=len(record.names))

    async def _wait_for_place(self) -> None:
        """Wait until a worker is free and no query waits, and take a place; first come, first served."""
        async with self._waiting:
            while not self._has_place():
                await asyncio.sleep(_POLL_S)
            self._num_under_way += 1

    def _release(self, _: object) -> None:
        self._num_under_way -= 1

    def _has_place(self) -> bool:
        state = self._pool.state()
        return state.ready and state.queue_depth == 0 and self._num_under_way < max(1, state.num_workers)

    async def _localize(self, record: BatchRecord, number: int) -> None:
        result = await self._result(record, number)
        await _persistently(lambda: self._store.put_result(record.id, number, result), "a result cannot be stored")

    async def _result(self, record: BatchRecord, number: int) -> Result:
        request_id = f"{record.id}-{number:05}"
        try:
            answer = await self._answer(record, number, request_id)
            return {"status": answer["status"], "answer": answer}
        except Exception as error:
            if not isinstance(error, EXPECTED_ERRORS):
                _log.exception("an image of a batch failed unexpectedly", number=number)
            return {"status": "failed", "error": problem_document(error, request_id)}

    async def _answer(self, record: BatchRecord, number: int, request_id: str) -> dict[str, Any]:
        """Return the answer of one query; what only takes time is tried again until it is over.

        A deadline may pass because the index of the map is rebuilt after a restart: a later try finds it.
        """
        if (known := await self._known_answer(record, number)) is not None:
            return known
        data = await _persistently(lambda: self._store.image(record.id, number), "an image cannot be read", _MAX_READS)
        open_image(data, IMAGE, self._max_pixels)
        image = QueryImage(data, camera=record.camera)
        query = LocalizeRequest(
            (image,), MapChoice(record.map_ids, record.tag, record.tenant), record.options, request_id, record.id
        )
        num_deadlines = 0
        while True:
            try:
                return (await self._localizations.answer(query)).model_dump(mode="json")
            except DeadlineExceededError:
                num_deadlines += 1
                if num_deadlines == _MAX_DEADLINES:
                    raise
            except TryAgainError as error:
                _log.warning("an image of a batch is retried", number=number, error=str(error))
                await asyncio.sleep(min(max(error.retry_after_s, _POLL_S), _LONGEST_PAUSE_S))

    async def _known_answer(self, record: BatchRecord, number: int) -> dict[str, Any] | None:
        """Return the answer that an image came with, None where the service does not have it any more."""
        if not record.answers or (answer_id := record.answers[number]) is None:
            return None
        try:
            found = await self._localizations.get(answer_id, record.tenant)
        except (LocalizationNotFoundError, CacheDownError):
            return None
        if found["status"] not in ("localized", "ambiguous", "not_localized"):
            return None
        camera = None if record.camera is None else asdict(record.camera)
        await self._localizations.note_batch(found, image_key(record.id, number), camera)
        return found


async def _persistently(work: Callable[[], Awaitable[_T]], what: str, max_tries: int | None = None) -> _T:
    """Return what `work` returns; after a disk error or a TryAgainError try again, with growing pauses."""
    pause_s, num_tries = _FIRST_PAUSE_S, 0
    while True:
        try:
            return await work()
        except (OSError, TryAgainError) as error:
            # A bucket that does not answer is not the fault of one image.
            num_tries += not isinstance(error, StorageAwayError)
            if num_tries == max_tries:
                raise
            _log.error(f"{what}; the service retries", error=str(error))
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
