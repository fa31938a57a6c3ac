"""What workers find in storage besides scans: how a map was registered, a copy of its index for when Redis has lost it, and its retrieval
vectors."""

import logging

from panoloc.core.map.retrieval_vectors import RETRIEVAL_VERSION
from panoloc.service.errors import MapNotFoundError, StorageError, StoredFileMissingError, TryAgainError
from panoloc.service.jobs import MapRef, RegisterJob
from panoloc.service.maps.record import folder_of, key_of, read_record
from panoloc.service.storage import Storage

_log = logging.getLogger(__name__)
_VECTORS = f"retrieval-{RETRIEVAL_VERSION}.npz"


def registration_of(storage: Storage, ref: MapRef) -> RegisterJob:
    """Return the job that registered a revision.

    Raises MapNotFoundError when the revision was deleted meanwhile, StoredFileDamagedError when its record is damaged.
    """
    gone = MapNotFoundError(f"{ref.id} revision {ref.revision}: deleted while it was asked for")
    try:
        revision = read_record(storage, ref.id).revision(ref.revision)
    except StoredFileMissingError as error:
        raise gone from error
    if revision is None:
        raise gone
    return RegisterJob(ref, revision.scan_key, revision.scan_name, revision.options, request_id="")


def stored_index(storage: Storage, ref: MapRef, digest: str) -> bytes | None:
    """Return the copy of an encoded index, None when it is missing or damaged. digest: of the configuration, hexadecimal."""
    return _stored(storage, key_of(ref, _name_of(digest)))


def stored_vectors(storage: Storage, ref: MapRef) -> bytes | None:
    """Return encoded retrieval vectors, None when they are missing or damaged."""
    return _stored(storage, key_of(ref, _VECTORS))


def store_vectors(storage: Storage, ref: MapRef, encoded: bytes) -> None:
    """Store retrieval vectors beside their map; a full disk is logged, no error: they can be made again from the index."""
    try:
        storage.put(key_of(ref, _VECTORS), encoded)
    except (TryAgainError, OSError) as error:
        _log.warning("the retrieval vectors of a map are not stored", extra={"map_id": ref.id, "error": str(error)})


def _stored(storage: Storage, key: str) -> bytes | None:
    try:
        return storage.read(key)
    except (StorageError, TryAgainError):
        return None


def store_index(storage: Storage, ref: MapRef, digest: str, encoded: bytes) -> None:
    """Store a copy of an index beside its map, in place of those of other configurations; a full disk is logged, no error."""
    name, folder = _name_of(digest), f"{folder_of(ref.id)}/{ref.revision}"
    try:
        storage.put(key_of(ref, name), encoded)
        for each in storage.names(folder):
            if each.startswith("index-") and each != name:
                storage.delete(f"{folder}/{each}")
    except (TryAgainError, OSError) as error:
        _log.warning("a map index has no copy on disk", extra={"map_id": ref.id, "error": str(error)})
    try:
        registration_of(storage, ref)
    except MapNotFoundError:  # its revision was replaced or deleted meanwhile
        storage.delete_all(folder)


def _name_of(digest: str) -> str:
    return f"index-{digest}.plmi"
