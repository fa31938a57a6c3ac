"""Checks at the start whether a bucket does what the service needs, while an operator can still correct it."""

import uuid

from panoloc.service.errors import ServiceError, StorageError, StoredFileChangedError
from panoloc.service.storage.bucket import BucketStorage
from panoloc.service.storage.protocol import Storage


class StorageUnusableError(RuntimeError):
    """The storage cannot be used as it is configured; the message names the correction."""


def check_at_start(storage: Storage, *, is_shared: bool) -> None:
    """Write, list, read and delete a probe; folders pass. is_shared: also replace it conditionally.

    Raises StorageUnusableError.
    """
    if not isinstance(storage, BucketStorage):
        return
    prefix = f"probes/{uuid.uuid4().hex}"
    key = f"{prefix}/probe"
    try:
        storage.put(key, b"first")
        if storage.names(prefix) != ["probe"]:
            raise StorageUnusableError(f"expected {storage.url} to list a file that was just written, but it does not")
        _, stamp = storage.read_stamped(key)
        if is_shared:
            storage.replace(key, b"second", stamp)
            _check_that_an_old_stamp_is_refused(storage, key, stamp)
        storage.delete_all(prefix)
    except StorageError as error:
        raise StorageUnusableError(f"{storage.url} does not keep a written file: {error}") from error
    except ServiceError as error:
        raise StorageUnusableError(str(error)) from error


def _check_that_an_old_stamp_is_refused(storage: BucketStorage, key: str, stamp: tuple[int, int, int] | str) -> None:
    try:
        storage.replace(key, b"third", stamp)
    except StoredFileChangedError:
        return
    raise StorageUnusableError(
        f"expected {storage.url} to refuse the overwrite of a changed file (If-Match), which several API replicas "
        "need, but it accepted the write; use a newer version of that storage, or one API replica without "
        "PANOLOC_SHARED"
    )
