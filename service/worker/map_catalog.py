"""A worker's view of storage: records of maps, scans, and copies of indexes for when Redis has lost them."""

import logging
from contextlib import AbstractContextManager
from pathlib import Path

from panoloc.service.errors import MapNotFoundError, StorageError, StoredFileMissingError, TryAgainError
from panoloc.service.jobs import MapRef, RegisterJob
from panoloc.service.maps.record import folder_of, key_of, read_record
from panoloc.service.storage import Storage

_log = logging.getLogger(__name__)


class MapCatalog:
    """Reads records and scans; writes only copies of indexes."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def registration_of(self, map_ref: MapRef) -> RegisterJob:
        """Return the job that registered a revision.

        Raises MapNotFoundError when the revision was deleted meanwhile, StoredFileDamagedError when its record is
        damaged.
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

    def temporary_folder(self) -> Path:
        """Return a folder for unpacked archives, on the disk of the scans: the system's own may be in memory."""
        return self._storage.spool_folder()

    def stored_index(self, map_ref: MapRef, digest: str) -> bytes | None:
        """Return the copy of an encoded index, None when it is missing or damaged. digest: of the configuration, hex."""
        try:
            return self._storage.read(_index_key(map_ref, digest))
        except (StorageError, TryAgainError):
            return None

    def store_index(self, map_ref: MapRef, digest: str, encoded: bytes) -> None:
        """Store a copy of an index beside its map; a full disk is logged, no error."""
        try:
            self._storage.put(_index_key(map_ref, digest), encoded)
            self._forget_other_indexes(map_ref, digest)
        except (TryAgainError, OSError) as error:
            _log.warning("a map index has no copy on disk", extra={"map_id": map_ref.id, "error": str(error)})
        self._forget_index_of_deleted(map_ref)

    def _forget_other_indexes(self, map_ref: MapRef, digest: str) -> None:
        """Remove copies of other configurations, which are never read again."""
        folder, kept = f"{folder_of(map_ref.id)}/{map_ref.revision}", f"index-{digest}.plmi"
        for name in self._storage.names(folder):
            if name.startswith("index-") and name.endswith(".plmi") and name != kept:
                self._storage.delete(f"{folder}/{name}")

    def _forget_index_of_deleted(self, map_ref: MapRef) -> None:
        """Delete the copy again when its revision was replaced or deleted meanwhile."""
        try:
            self.registration_of(map_ref)
        except MapNotFoundError:
            self._storage.delete_all(f"{folder_of(map_ref.id)}/{map_ref.revision}")


def _index_key(map_ref: MapRef, digest: str) -> str:
    return key_of(map_ref, f"index-{digest}.plmi")


def _gone(map_ref: MapRef) -> MapNotFoundError:
    return MapNotFoundError(f"{map_ref.id} revision {map_ref.revision}: deleted while it was asked for")
