"""Records and results of batches as files."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from service.batches.record import (
    BatchRecord,
    Result,
    folder_of,
    image_key,
    record_key,
    result_from_json,
    result_key,
    results_prefix,
)
from service.errors import StoredFileDamagedError, StoredFileMissingError
from service.storage import Storage

# A bucket answers each after a while, and many in the same while.
_AT_A_TIME = 8


class StoredBatches:
    """Blocking."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def adopt(
        self, record: BatchRecord, images: Sequence[tuple[Path, str]], check: Callable[[], None] = lambda: None
    ) -> None:
        """Take over images, each with its SHA-256, and then the record, which makes a batch of them. check: raises where it must not."""
        keys = [image_key(record.id, number) for number in range(len(images))]
        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            for _ in threads.map(self._storage.adopt, keys, *zip(*images, strict=True)):
                pass
        check()
        self._storage.replace(record_key(record.id), record.to_json())

    def read(self, batch_id: str) -> BatchRecord | None:
        """Return a record, None where an upload never became a batch. Raises StorageError."""
        if not self.is_stored(batch_id):
            return None
        return BatchRecord.from_json(self._storage.read(record_key(batch_id)), record_key(batch_id))

    def is_stored(self, batch_id: str) -> bool:
        """Tell whether there is a batch, and not only what was to become one."""
        return "batch.json" in self._storage.names(folder_of(batch_id))

    def read_results(self, batch_id: str, numbers: list[int]) -> dict[int, Result | None]:
        """Return those that are there, None for one that is damaged."""
        present = set(self._storage.names(results_prefix(batch_id)))
        wanted = [number for number in numbers if f"{number:05}.json" in present]
        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            return dict(zip(wanted, threads.map(partial(self._read_result, batch_id), wanted), strict=True))

    def _read_result(self, batch_id: str, number: int) -> Result | None:
        key = result_key(batch_id, number)
        try:
            return result_from_json(self._storage.read(key), key)
        except (StoredFileDamagedError, StoredFileMissingError):
            return None
