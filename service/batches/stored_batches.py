"""Records and results of batches as files."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from panoloc.service.batches.record import (
    BATCH,
    RESULT,
    BatchRecord,
    folder_of,
    image_key,
    record_key,
    result_key,
    results_prefix,
)
from panoloc.service.errors import StoredFileDamagedError, StoredFileMissingError
from panoloc.service.jobs import Result
from panoloc.service.storage import Storage
from panoloc.service.storage.sealed_json import seal, unseal

# A bucket answers each after a while, and many in the same while.
_AT_A_TIME = 8


class StoredBatches:
    """Blocking. Every method raises as `Storage` does."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def adopt(self, record: BatchRecord, images: Sequence[tuple[Path, str]], check: Callable[[], None]) -> None:
        """Take over images, each with its SHA-256, and then the record, which makes a batch of them.

        check: raises where the record must not be written any more.
        """
        keys = [image_key(record.id, number) for number in range(len(images))]
        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            for _ in threads.map(self._storage.adopt, keys, *zip(*images, strict=True)):
                pass
        check()
        self._storage.replace(record_key(record.id), seal(BATCH, record))

    def read(self, batch_id: str) -> BatchRecord | None:
        """Return a record, None where an upload never became a batch."""
        if not self.is_stored(batch_id):
            return None
        return unseal(BATCH, self._storage.read(record_key(batch_id)), record_key(batch_id))

    def is_stored(self, batch_id: str) -> bool:
        """Tell whether there is a batch, and not only an upload that was to become one."""
        return "batch.json" in self._storage.names(folder_of(batch_id))

    def numbers_done(self, batch_id: str) -> set[int]:
        """Return the numbers of the images with a result."""
        return {int(name.removesuffix(".json")) for name in self._storage.names(results_prefix(batch_id))}

    def read_results(self, batch_id: str, numbers: Iterable[int]) -> dict[int, Result | None]:
        """Return results; None for one that is damaged or gone."""
        wanted = list(numbers)

        def read(number: int) -> Result | None:
            key = result_key(batch_id, number)
            try:
                return unseal(RESULT, self._storage.read(key), key)
            except (StoredFileDamagedError, StoredFileMissingError):
                return None

        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            return dict(zip(wanted, threads.map(read, wanted), strict=True))

    def put_result(self, batch_id: str, number: int, result: Result) -> None:
        """Store the result of an image."""
        self._storage.replace(result_key(batch_id, number), seal(RESULT, result))
