"""All batches: records and progress in memory, images and results in storage.

The only writer of either; where other processes share the storage, one of them at a time.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import structlog

from panoloc.service.batches.record import BatchRecord, StoredBatches, folder_of, image_key
from panoloc.service.errors import BatchLimitError, BatchNotFoundError, StorageError
from panoloc.service.jobs import Result
from panoloc.service.sharing.change_signal import Publish, publish_nothing
from panoloc.service.sharing.locks import HeldLock, Locks, uninterrupted
from panoloc.service.storage import Storage

_log = structlog.get_logger(__name__)

MOST_BATCHES = 1000
_ID = re.compile(r"batch_[0-9a-f]{16}")


@dataclass(eq=False)
class _Batch:
    """done: numbers of images with a result. statuses: of those results that were read or written here.

    damaged: images whose stored result cannot be used. num_written: results that this process has written. by_hand: numbers of images that
    a person has placed.
    """

    record: BatchRecord
    done: set[int] = field(default_factory=set)
    statuses: dict[int, str] = field(default_factory=dict)
    damaged: set[int] = field(default_factory=set)
    num_written: int = 0
    by_hand: set[int] = field(default_factory=set)


class BatchStore:
    """Used from one event loop.

    redo: called for a batch with a damaged stored result: its image has none any more. publish: awaited with the id of each batch that
    this process has made, deleted, or has a result of.
    """

    def __init__(self, storage: Storage, max_batches: int, locks: Locks) -> None:
        """locks: of the processes that share the storage."""
        self._storage = storage
        self._files = StoredBatches(storage)
        self._locks = locks
        self._max_batches = max_batches
        self._batches: dict[str, _Batch] = {}
        # Deleted by us, now or before: no id comes again.
        self._deleted: set[str] = set()
        self._num_coming = 0
        self._reading_statuses = asyncio.Lock()
        self.redo: Callable[[BatchRecord], None] = lambda record: None
        self.publish: Publish = publish_nothing

    async def load(self) -> None:
        """Read all records; uploads that never became a batch are removed, unreadable records are left alone."""
        for batch_id in await asyncio.to_thread(self._storage.names, "batches"):
            if not await self._look(batch_id):
                await self._remove_unfinished(batch_id)

    async def refresh(self) -> None:
        """Look what other processes have made, done and deleted."""
        known_before = set(self._batches)
        stored = await asyncio.to_thread(self._storage.stamps, "batches", "batch.json")
        for batch_id in known_before - stored.keys():
            self._batches.pop(batch_id, None)
        for batch_id in stored:
            await self.find(batch_id)
        for record in self.unfinished():
            await self.done(record.id)

    async def refresh_one(self, batch_id: str) -> None:
        """Look what other processes have made of one batch."""
        if (batch := self._batches.get(batch_id)) is None:
            await self.find(batch_id)
        elif (record := await asyncio.to_thread(self._files.read, batch_id)) is not None:
            batch.record = record
            await self.done(batch_id)
        else:
            self._batches.pop(batch_id, None)

    async def find(self, batch_id: str) -> None:
        """Look for an unknown batch, which another process may have made a moment ago. Raises StorageAwayError."""
        if batch_id not in self._batches and self._locks.is_shared and _ID.fullmatch(batch_id):
            await self._look(batch_id)

    def get(self, batch_id: str, tenant: str | None = None) -> BatchRecord:
        """Return a batch; tenant: of the caller, None for one that sees all. Raises BatchNotFoundError."""
        batch = self._batches.get(batch_id)
        if batch is None or (tenant is not None and batch.record.tenant != tenant):
            raise BatchNotFoundError(
                f"expected the id of a batch, got {batch_id[:80]!r}, which is unknown or deleted; send the images again"
            )
        return batch.record

    def has(self, batch_id: str) -> bool:
        """Tell whether there is a batch under this id."""
        return batch_id in self._batches

    async def try_run(self, batch_id: str) -> HeldLock | None:
        """Return the lock on the work on a batch, None while another process has it.

        Raises StorageFullError, StorageReadOnlyError and CacheDownError.
        """
        return await self._locks.try_hold(f"run-{batch_id}")

    def unfinished(self) -> list[BatchRecord]:
        """Return the batches with images that have no result yet, oldest first."""
        waiting = [each.record for each in self._batches.values() if len(each.done) < len(each.record.names)]
        return sorted(waiting, key=_order)

    def after(self, place: tuple[str, str], tenant: str | None = None) -> list[BatchRecord]:
        """Return the batches that come after a place, (created_at, id), oldest first; tenant: as in `get`."""
        records = (each.record for each in self._batches.values())
        seen = (record for record in records if tenant is None or record.tenant == tenant)
        return sorted((record for record in seen if _order(record) > place), key=_order)

    def num_done(self, batch_id: str) -> int:
        """Return how many images of a batch have a result; nothing is read for that."""
        return len(self._batches[batch_id].done) if batch_id in self._batches else 0

    def check_room(self) -> None:
        """Raise BatchLimitError when there are as many batches as allowed."""
        if len(self._batches) + self._num_coming >= self._max_batches:
            raise BatchLimitError(
                f"expected fewer than {self._max_batches} batches, but the limit is reached; delete a batch that is no "
                "longer needed"
            )

    async def add(self, record: BatchRecord, images: Sequence[tuple[Path, str]]) -> None:
        """Take over the images, each with its SHA-256, and store the batch durably.

        Raises OSError and BatchLimitError, and leaves nothing behind then.
        """
        # Again: others may have come while this one was uploaded.
        self.check_room()
        self._num_coming += 1
        lock = _lock_of(record.id)
        try:
            async with self._locks.held(lock):
                check = partial(self._locks.check_sure, lock)
                await uninterrupted(asyncio.to_thread(self._files.adopt, record, images, check))
        except BaseException:
            await uninterrupted(asyncio.to_thread(self._storage.delete_all, folder_of(record.id)))
            raise
        finally:
            self._num_coming -= 1
        self._batches[record.id] = _Batch(record)
        await self.publish(record.id)

    async def done(self, batch_id: str) -> set[int]:
        """Return the numbers of the images that have a result."""
        if self._locks.is_shared:
            listed = await asyncio.to_thread(self._files.numbers, batch_id, "results")
            if (batch := self._batches.get(batch_id)) is not None:
                batch.done |= listed - batch.damaged
                batch.by_hand = await asyncio.to_thread(self._files.numbers, batch_id, "by_hand")
        return set(self._batches[batch_id].done) if batch_id in self._batches else set()

    async def counts(self, batch_id: str) -> Counter[str]:
        """Return how many images ended with each status."""
        async with self._reading_statuses:
            done = await self.done(batch_id)
            if (batch := self._batches.get(batch_id)) is None:
                return Counter()
            for number, result in (await self._read(batch, done - batch.statuses.keys())).items():
                batch.statuses.setdefault(number, result["status"])
            return Counter("localized" if each in batch.by_hand else batch.statuses[each] for each in batch.statuses)

    async def results(self, batch_id: str, numbers: Iterable[int]) -> dict[int, Result]:
        """Return the results of those images that have one; a damaged one is none, and its image localized again."""
        done = await self.done(batch_id)
        batch = self._batches.get(batch_id)
        if batch is None:
            return {}
        return await self._read(batch, [number for number in numbers if number in done], batch.by_hand)

    async def put_result(self, batch_id: str, number: int, result: Result) -> None:
        """Store the result of an image; to its end, so that nothing is written after a batch is deleted."""
        async with self._locks.held(_lock_of(batch_id)):
            if self._locks.is_shared and not await asyncio.to_thread(self._files.is_stored, batch_id):
                return
            await uninterrupted(asyncio.to_thread(self._files.put_result, batch_id, number, result))
        if (batch := self._batches.get(batch_id)) is not None:
            batch.num_written += 1
            batch.done.add(number)
            batch.statuses[number] = result["status"]
            batch.damaged.discard(number)
        await self.publish(batch_id)

    async def put_by_hand(self, batch_id: str, number: int, result: Result | None) -> None:
        """Show an image where a person has placed it; None: as its own result has it, again."""
        async with self._locks.held(_lock_of(batch_id)):
            if self._locks.is_shared:
                await self.refresh_one(batch_id)
            batch = self._batches[self.get(batch_id).id]
            await uninterrupted(asyncio.to_thread(self._files.put_by_hand, batch_id, number, result))
        batch.by_hand = batch.by_hand - {number} if result is None else batch.by_hand | {number}
        await self.publish(batch_id)

    async def rename(self, batch_id: str, name: str) -> BatchRecord:
        """Give a batch another name, and return its record. Raises BatchNotFoundError."""
        async with self._locks.held(_lock_of(batch_id)):
            if self._locks.is_shared:
                await self.refresh_one(batch_id)
            batch = self._batches[self.get(batch_id).id]
            batch.record = replace(batch.record, name=name)
            await uninterrupted(asyncio.to_thread(self._files.put_record, batch.record))
        await self.publish(batch_id)
        return batch.record

    async def image(self, batch_id: str, number: int) -> bytes:
        """Return an image as it was uploaded. Raises StorageError."""
        return await asyncio.to_thread(self._storage.read, image_key(batch_id, number))

    async def remove(self, batch_id: str) -> None:
        """Delete a batch with its images and results. Raises BatchNotFoundError."""
        self.get(batch_id)
        batch = self._batches.pop(batch_id)
        self._deleted.add(batch_id)
        try:
            async with self._locks.held(_lock_of(batch_id)):
                await uninterrupted(asyncio.to_thread(self._storage.delete_all, folder_of(batch_id)))
        except BaseException:
            self._deleted.discard(batch_id)
            self._batches[batch_id] = batch
            raise
        await self.publish(batch_id)

    async def _look(self, batch_id: str) -> bool:
        """Read a batch that is not known; return False where it is none, but an upload that was to become one."""
        try:
            record = await asyncio.to_thread(self._files.read, batch_id)
            done, by_hand = set[int](), set[int]()
            if record is not None:
                done = await asyncio.to_thread(self._files.numbers, batch_id, "results")
                by_hand = await asyncio.to_thread(self._files.numbers, batch_id, "by_hand")
        except StorageError as error:
            _log.error("a batch is skipped, because its record cannot be read", batch_id=batch_id, error=str(error))
            return True
        if record is not None and batch_id not in self._batches and batch_id not in self._deleted:
            self._batches[batch_id] = _Batch(record, done, by_hand=by_hand)
        return record is not None

    async def _read(self, batch: _Batch, numbers: Iterable[int], by_hand: Container[int] = ()) -> dict[int, Result]:
        """Return results; where one is damaged, its image waits again. by_hand: as of `StoredBatches.read_results`."""
        batch_id, num_written = batch.record.id, batch.num_written
        found = await asyncio.to_thread(self._files.read_results, batch_id, numbers, by_hand)
        damaged = {number for number, result in found.items() if result is None} - batch.damaged
        # One that was written meanwhile may be as it should be: the next reader finds out.
        if damaged and batch.num_written == num_written and self._batches.get(batch_id) is batch:
            batch.damaged |= damaged
            batch.done -= damaged
            for number in damaged:
                batch.statuses.pop(number, None)
            _log.error(
                "results are damaged; their images are localized again", batch_id=batch_id, numbers=sorted(damaged)
            )
            self.redo(batch.record)
        return {number: result for number, result in found.items() if result is not None}

    async def _remove_unfinished(self, batch_id: str) -> None:
        """Remove an upload that never became a batch, unless another process is at it."""
        lock = await self._locks.try_hold(_lock_of(batch_id))
        if lock is None:
            return
        try:
            if not await asyncio.to_thread(self._files.is_stored, batch_id):
                await asyncio.to_thread(self._storage.delete_all, folder_of(batch_id))
        finally:
            lock.release()


def _lock_of(batch_id: str) -> str:
    """Return the lock that is held while something is done to a batch."""
    return f"batch-{batch_id}"


def _order(record: BatchRecord) -> tuple[str, str]:
    return record.created_at, record.id
