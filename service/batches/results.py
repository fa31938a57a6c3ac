"""What became of the images of all batches: results in storage, and in memory how many there are and with which status."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable

import structlog

from service.batches.record import Result, results_prefix
from service.batches.stored_batches import StoredBatches
from service.storage import Storage

_log = structlog.get_logger(__name__)


class BatchResults:
    """Used from one event loop.

    is_shared: other processes write results as well. when_damaged: called with the id of a batch of which a stored result turned out to be
    damaged, so that its image has none any more.
    """

    def __init__(self, storage: Storage, files: StoredBatches, is_shared: bool) -> None:
        self.when_damaged: Callable[[str], None] = lambda batch_id: None
        self._storage = storage
        self._files = files
        self._is_shared = is_shared
        # Of the batches that are known here, and of no others.
        self._num_done: dict[str, int] = {}
        self._statuses: dict[str, dict[int, str]] = {}
        self._all_known: set[str] = set()
        self._reading = asyncio.Lock()
        self._damaged: dict[str, set[int]] = {}
        # The batches whose results are being read, each with what is written meanwhile.
        self._readings: list[tuple[str, set[int]]] = []

    def begin(self, batch_id: str, num_done: int = 0) -> None:
        """Know a batch from now on."""
        self._num_done[batch_id] = num_done

    def forget(self, batch_id: str) -> None:
        """Know a batch no more."""
        self._num_done.pop(batch_id, None)
        self._statuses.pop(batch_id, None)
        self._damaged.pop(batch_id, None)
        self._all_known.discard(batch_id)

    def num_done(self, batch_id: str) -> int:
        """Return how many images of a batch have a result; nothing is read for that."""
        return self._num_done.get(batch_id, 0)

    async def count(self, batch_id: str) -> None:
        """Look how many results other processes have written of a batch."""
        num_done = len(await self.done(batch_id))
        if batch_id in self._num_done:
            self._num_done[batch_id] = num_done

    async def done(self, batch_id: str) -> set[int]:
        """Return the numbers of the images that have a result."""
        names = await asyncio.to_thread(self._storage.names, results_prefix(batch_id))
        return {int(name.removesuffix(".json")) for name in names} - self._damaged.get(batch_id, set())

    async def counts(self, batch_id: str) -> Counter[str]:
        """Return how many images ended with each status."""
        async with self._reading:
            known = self._statuses.setdefault(batch_id, {})
            if batch_id not in self._all_known:
                # What is done meanwhile is noted by `note`.
                missing = await self.done(batch_id) - known.keys()
                for number, result in (await self.read(batch_id, missing)).items():
                    known[number] = result["status"]
                if not self._is_shared:
                    self._all_known.add(batch_id)
            return Counter(known.values())

    async def read(self, batch_id: str, numbers: Iterable[int]) -> dict[int, Result]:
        """Return the results of those images that have one; one that is damaged is none."""
        reading = (batch_id, set[int]())
        self._readings.append(reading)
        try:
            found = await asyncio.to_thread(self._files.read_results, batch_id, list(numbers))
        finally:
            self._readings = [one for one in self._readings if one is not reading]
        # What was written anew after it was read is as it should be.
        self._note_damaged(batch_id, {number for number, result in found.items() if result is None} - reading[1])
        return {number: result for number, result in found.items() if result is not None}

    def note(self, batch_id: str, number: int, result: Result) -> None:
        """Know a result that was written a moment ago."""
        self._damaged.get(batch_id, set()).discard(number)
        for read, written in self._readings:
            if read == batch_id:
                written.add(number)
        known = self._statuses.setdefault(batch_id, {})
        # With others it is counted again at every look.
        if batch_id in self._num_done and (not self._is_shared or number not in known):
            self._num_done[batch_id] += 1
        known[number] = result["status"]

    def _note_damaged(self, batch_id: str, numbers: set[int]) -> None:
        """Take images for waiting again whose results cannot be used; what writes them anew replaces the files."""
        known = self._damaged.setdefault(batch_id, set())
        new = numbers - known
        if batch_id not in self._num_done or not new:
            return
        known |= new
        for number in new:
            self._statuses.get(batch_id, {}).pop(number, None)
        self._num_done[batch_id] -= len(new)
        _log.error("results are damaged, their images are localized again", batch_id=batch_id, numbers=sorted(new))
        self.when_damaged(batch_id)
