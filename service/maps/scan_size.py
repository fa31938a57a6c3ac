"""How large a scan is for the limits of its registration: an archive counts with what it unpacks to."""

from core.zip_opening import unpacked_bytes
from service.errors import StorageError
from service.limits.registration_limits import MAX_COUNTED_BYTES
from service.maps.record import Revision
from service.storage import Storage


def counted_bytes(storage: Storage, revision: Revision) -> int:
    """Return the bytes of a scan, of one that is called an archive those that it announces, at most MAX_COUNTED_BYTES."""
    if not revision.scan_key.lower().endswith(".zip"):
        return revision.scan_bytes
    try:
        with storage.local_copy(revision.scan_key, checked=False) as path:
            return unpacked_bytes(path, MAX_COUNTED_BYTES)
    except StorageError:  # what is missing is told by the worker
        return revision.scan_bytes
