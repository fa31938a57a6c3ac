"""All batches: what was asked in memory, images and results in storage.

The only writer of either; where other processes share the storage, one of them at a time.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path

import structlog

from service.batches.record import BatchRecord, Result, folder_of, image_key, result_key, result_to_json
from service.batches.results import BatchResults
from service.batches.stored_batches import StoredBatches
from service.errors import BatchLimitError, BatchNotFoundError, StorageError
from service.sharing.folder_locks import FolderLocks, OwnFolderLocks, check_sure
from service.sharing.held_lock import HeldLock
from service.storage import Storage

_log = structlog.get_logger(__name__)

MOST_BATCHES = 1000
_ID = re.compile(r"batch_[0-9a-f]{16}")


class BatchStore:
    """Used from one event loop."""

    def __init__(self, storage: Storage, max_batches: int, locks: FolderLocks | None = None) -> None:
        """locks: of the processes that share the storage; None: there is no other."""
        self._storage = storage
        self._files = StoredBatches(storage)
        self._locks = locks or OwnFolderLocks()
        self._max_batches = max_batches
        self._records: dict[str, BatchRecord] = {}
        # Deleted by us, now or before: no id comes again.
        self._going: set[str] = set()
        self._results = BatchResults(storage, self._files, self._locks.is_shared)
        self._num_coming = 0
        self._tell: Callable[[str], Awaitable[None]] = _tell_nobody

    def call_when_damaged(self, redo: Callable[[BatchRecord], None]) -> None:
        """Name what is called for a batch of which a stored result turned out to be damaged: its image has none any more."""
        self._results.when_damaged = lambda batch_id: redo(self._records[batch_id])

    def call_on_change(self, tell: Callable[[str], Awaitable[None]]) -> None:
        """Name what is awaited with the id of each batch that this process has made, deleted, or has a result of."""
        self._tell = tell

    async def load(self) -> None:
        """Read all records; uploads that never became a batch are removed, a record that cannot be read is logged and left alone."""
        for batch_id in await asyncio.to_thread(self._storage.names, "batches"):
            try:
                record = await asyncio.to_thread(self._files.read, batch_id)
            except StorageError as error:
                _log.error("a batch is left alone, its record cannot be read", batch_id=batch_id, error=str(error))
                continue
            if record is None:
                await self._remove_unfinished(batch_id)
                continue
            self._records[batch_id] = record
            self._results.begin(batch_id, len(await self.done(batch_id)))

    async def refresh(self) -> None:
        """Look what other processes have made, done and deleted; does nothing where there are none."""
        if not self._locks.is_shared:
            return
        known_before = set(self._records)
        stored = await asyncio.to_thread(self._storage.stamps, "batches", "batch.json")
        for batch_id in known_before - stored.keys():
            self._forget(batch_id)
        for batch_id in stored:
            await self.find(batch_id)
        for record in self.unfinished():
            await self._results.count(record.id)

    async def refresh_one(self, batch_id: str) -> None:
        """Look what other processes have made of one batch."""
        if not self._locks.is_shared or not _ID.fullmatch(batch_id):
            return
        if batch_id not in self._records:
            await self.find(batch_id)
        elif await asyncio.to_thread(self._files.is_stored, batch_id):
            await self._results.count(batch_id)
        else:
            self._forget(batch_id)

    async def find(self, batch_id: str) -> None:
        """Look for a batch that is not known here: another process may have made it a moment ago. Raises StorageAwayError."""
        if batch_id in self._records or not self._locks.is_shared or not _ID.fullmatch(batch_id):
            return
        try:
            found = await asyncio.to_thread(self._files.read, batch_id)
            num_done = 0 if found is None else len(await self.done(batch_id))
        except StorageError as error:
            _log.error("a batch is left alone, its record cannot be read", batch_id=batch_id, error=str(error))
            return
        if found is not None and batch_id not in self._records and batch_id not in self._going:
            self._records[batch_id] = found
            self._results.begin(batch_id, num_done)

    def get(self, batch_id: str, tenant: str | None = None) -> BatchRecord:
        """Return a batch; tenant: of the caller, None for one that sees all. Raises BatchNotFoundError."""
        record = self._records.get(batch_id)
        if record is None or (tenant is not None and record.tenant != tenant):
            raise BatchNotFoundError(
                f"expected the id of a batch, got {batch_id[:80]!r}, which is unknown or deleted; send the images again"
            )
        return record

    def has(self, batch_id: str) -> bool:
        """Tell whether there is a batch under this id."""
        return batch_id in self._records

    async def try_run(self, batch_id: str) -> HeldLock | None:
        """Return what says that a batch is ours alone to work on, None while another process has it.

        Raises StorageFullError and StorageReadOnlyError.
        """
        return await self._locks.try_hold(f"run-{batch_id}")

    def unfinished(self) -> list[BatchRecord]:
        """Return the batches with images that have no result yet, oldest first."""
        waiting = [each for each in self._records.values() if self.num_done(each.id) < len(each.names)]
        return sorted(waiting, key=_order)

    def after(self, place: tuple[str, str], tenant: str | None = None) -> list[BatchRecord]:
        """Return the batches that come after a place, (created_at, id), oldest first; tenant: as in `get`."""
        seen = (each for each in self._records.values() if tenant is None or each.tenant == tenant)
        return sorted((each for each in seen if _order(each) > place), key=_order)

    def num_done(self, batch_id: str) -> int:
        """Return how many images of a batch have a result; nothing is read for that."""
        return self._results.num_done(batch_id)

    def check_room(self) -> None:
        """Raise BatchLimitError when there are as many batches as allowed."""
        if len(self._records) + self._num_coming >= self._max_batches:
            raise BatchLimitError(
                f"expected fewer than {self._max_batches} batches, got as many; delete one you do not need"
            )

    async def add(self, record: BatchRecord, images: Sequence[tuple[Path, str]]) -> None:
        """Take over the images, each with its SHA-256, and store the batch durably.

        Raises OSError and BatchLimitError, and leaves nothing behind then.
        """
        # Again: others may have come while this one was uploaded.
        self.check_room()
        self._num_coming += 1
        try:
            async with self._turn(record.id):
                await _to_the_end(
                    self._files.adopt, record, images, partial(check_sure, self._locks, _turn_of(record.id))
                )
        except BaseException:
            await _to_the_end(self._storage.delete_all, folder_of(record.id))
            raise
        finally:
            self._num_coming -= 1
        self._records[record.id] = record
        self._results.begin(record.id)
        await self._tell(record.id)

    async def done(self, batch_id: str) -> set[int]:
        """Return the numbers of the images that have a result."""
        return await self._results.done(batch_id)

    async def counts(self, batch_id: str) -> Counter[str]:
        """Return how many images ended with each status."""
        return await self._results.counts(batch_id)

    async def results(self, batch_id: str, numbers: Iterable[int]) -> dict[int, Result]:
        """Return the results of those images that have one; one that is damaged is none, and its image is localized again."""
        return await self._results.read(batch_id, numbers)

    async def put_result(self, batch_id: str, number: int, result: Result) -> None:
        """Store what became of an image; to its end, so that nothing is written after a batch is deleted."""
        async with self._turn(batch_id):
            if self._locks.is_shared and not await asyncio.to_thread(self._files.is_stored, batch_id):
                return
            await _to_the_end(self._storage.replace, result_key(batch_id, number), result_to_json(result))
        self._results.note(batch_id, number, result)
        await self._tell(batch_id)

    async def image(self, batch_id: str, number: int) -> bytes:
        """Return an image as it was uploaded. Raises StorageError."""
        return await asyncio.to_thread(self._storage.read, image_key(batch_id, number))

    async def remove(self, batch_id: str) -> None:
        """Delete a batch with its images and results. Raises BatchNotFoundError."""
        self.get(batch_id)
        self._going.add(batch_id)
        self._forget(batch_id)
        try:
            async with self._turn(batch_id):
                await _to_the_end(self._storage.delete_all, folder_of(batch_id))
        except BaseException:
            self._going.discard(batch_id)
            raise
        await self._tell(batch_id)

    def _turn(self, batch_id: str) -> AbstractAsyncContextManager[None]:
        return self._locks.held(_turn_of(batch_id))

    def _forget(self, batch_id: str) -> None:
        self._records.pop(batch_id, None)
        self._results.forget(batch_id)

    async def _remove_unfinished(self, batch_id: str) -> None:
        """Remove an upload that never became a batch, unless another process is at it."""
        lock = await self._locks.try_hold(_turn_of(batch_id))
        if lock is None:
            return
        try:
            if not await asyncio.to_thread(self._files.is_stored, batch_id):
                await asyncio.to_thread(self._storage.delete_all, folder_of(batch_id))
        finally:
            lock.release()


async def _tell_nobody(batch_id: str) -> None:
    """Stand in for telling other processes of a change."""


def _turn_of(batch_id: str) -> str:
    """Return the lock that is held while something is done to a batch."""
    return f"batch-{batch_id}"


def _order(record: BatchRecord) -> tuple[str, str]:
    return record.created_at, record.id


async def _to_the_end(work: Callable[..., object], *arguments: object) -> None:
    """Run blocking work in a thread; a cancellation takes effect after it."""
    task = asyncio.create_task(asyncio.to_thread(work, *arguments))
    try:
        await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait({task})
        raise
