"""One batch: the request, as it is stored; and the result of each image.

In storage: `batches/{id}/batch.json`, last of all that an upload brings; `images/00000` and so on;
`results/00000.json` as each image is done; and beside its result, of one that a person has placed,
`by_hand/00000.json`. All but images contain their own digest, see `panoloc.service.storage.sealed_json`.
"""

from collections.abc import Callable, Container, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from panoloc.core.camera.camera import CameraDescription
from panoloc.service.errors import StoredFileDamagedError, StoredFileMissingError
from panoloc.service.jobs import QueryOptions, Result
from panoloc.service.storage import Storage
from panoloc.service.storage.sealed_json import seal, unseal

# A bucket answers each after a while, and many in the same while.
_AT_A_TIME = 8
_Folder = Literal["results", "by_hand"]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BatchRecord:
    """The request. Times are RFC 3339 in UTC.

    map_ids, tag: as in `panoloc.service.maps.selection.MapChoice`. camera: of all images; None: each says so itself.
    name: for people, "" in records of former releases. answers: ids of answers that the images already have, None for those without; empty
    where none has one. names: of the images, each once, in their order. ignored: files of an archive that are no images by their names.
    tenant: see `panoloc.service.keys.caller.Caller`.
    """

    id: str
    created_at: str
    map_ids: tuple[str, ...]
    tag: str | None
    options: QueryOptions
    camera: CameraDescription | None
    names: tuple[str, ...]
    ignored: tuple[str, ...] = ()
    tenant: str | None = None
    name: str = ""
    answers: tuple[str | None, ...] = ()


BATCH = TypeAdapter(BatchRecord)
RESULT: TypeAdapter[Result] = TypeAdapter(Result)


def folder_of(batch_id: str) -> str:
    """Return the prefix below which everything of a batch is stored."""
    return f"batches/{batch_id}"


def image_key(batch_id: str, number: int) -> str:
    """Return the key of an image; number: from 0."""
    return f"{folder_of(batch_id)}/images/{number:05}"


def _record_key(batch_id: str) -> str:
    return f"{folder_of(batch_id)}/batch.json"


def _result_key(batch_id: str, folder: _Folder, number: int) -> str:
    return f"{folder_of(batch_id)}/{folder}/{number:05}.json"


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
        self.put_record(record)

    def put_record(self, record: BatchRecord) -> None:
        """Store a record, over the former one."""
        self._storage.replace(_record_key(record.id), seal(BATCH, record))

    def read(self, batch_id: str) -> BatchRecord | None:
        """Return a record, None where an upload never became a batch."""
        if not self.is_stored(batch_id):
            return None
        return unseal(BATCH, self._storage.read(_record_key(batch_id)), _record_key(batch_id))

    def is_stored(self, batch_id: str) -> bool:
        """Tell whether there is a batch, and not only an upload that was to become one."""
        return "batch.json" in self._storage.names(folder_of(batch_id))

    def numbers(self, batch_id: str, folder: _Folder) -> set[int]:
        """Return the numbers of the images with a result, or of those that a person has placed."""
        return {int(name.removesuffix(".json")) for name in self._storage.names(f"{folder_of(batch_id)}/{folder}")}

    def read_results(
        self, batch_id: str, numbers: Iterable[int], by_hand: Container[int] = ()
    ) -> dict[int, Result | None]:
        """Return results; None for one that is damaged or gone. by_hand: numbers of those that are read as a person has placed them."""
        wanted = list(numbers)

        def read(number: int) -> Result | None:
            folders: tuple[_Folder, ...] = ("by_hand", "results") if number in by_hand else ("results",)
            for key in (_result_key(batch_id, folder, number) for folder in folders):
                with suppress(StoredFileDamagedError, StoredFileMissingError):
                    return unseal(RESULT, self._storage.read(key), key)
            return None

        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            return dict(zip(wanted, threads.map(read, wanted), strict=True))

    def put_result(self, batch_id: str, number: int, result: Result) -> None:
        """Store the result of an image."""
        self._storage.replace(_result_key(batch_id, "results", number), seal(RESULT, result))

    def put_by_hand(self, batch_id: str, number: int, result: Result | None) -> None:
        """Store where a person has placed an image; None: forget it."""
        key = _result_key(batch_id, "by_hand", number)
        if result is None:
            self._storage.delete(key)
        else:
            self._storage.replace(key, seal(RESULT, result))
