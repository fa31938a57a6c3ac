"""What a worker asks of storage: how a map was registered, and its scan."""

from contextlib import AbstractContextManager
from pathlib import Path

from service.errors import MapNotFoundError, StoredFileMissingError
from service.jobs import MapRef, RegisterJob
from service.maps.record import read_record
from service.storage import Storage


class MapCatalog:
    """Reads what the HTTP process wrote; never writes."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def registration_of(self, map_ref: MapRef) -> RegisterJob:
        """Return how a revision was registered.

        Raises MapNotFoundError when it was deleted meanwhile, StoredFileDamagedError when its record is damaged.
        """
        try:
            revision = read_record(self._storage, map_ref.id).revision(map_ref.revision)
        except StoredFileMissingError as error:
            raise _gone(map_ref) from error
        if revision is None:
            raise _gone(map_ref)
        return RegisterJob(map_ref, revision.scan_key, revision.scan_name, revision.options, request_id="")

    def scan_file(self, job: RegisterJob) -> AbstractContextManager[Path]:
        """Return the scan as a local file, checked against its digest, for the duration of a block.

        Raises StoredFileMissingError and StoredFileDamagedError.
        """
        return self._storage.local_copy(job.scan_key)


def _gone(map_ref: MapRef) -> MapNotFoundError:
    return MapNotFoundError(f"{map_ref.id} revision {map_ref.revision}: deleted while it was asked for")
