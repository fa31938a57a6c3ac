"""Errors of a bucket translated into what a caller can do about them."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from obstore.exceptions import (
    AlreadyExistsError,
    BaseError,
    PermissionDeniedError,
    PreconditionError,
    UnauthenticatedError,
)

from panoloc.service.errors import (
    ServiceError,
    StorageAwayError,
    StorageFullError,
    StorageReadOnlyError,
    StoredFileChangedError,
)
from panoloc.service.storage.protocol import missing

_RETRY_AFTER_S = 10
_LONGEST_REASON = 200
_CODE = re.compile(r"<Code>(\w+)</Code>|\"code\": ?\"?(\w+)")
_FULL = re.compile(r"status code: 507|XMinioStorageFull|QuotaExceeded|InsufficientStorage|AccountStorageLimit")
_NO_BUCKET = re.compile(r"NoSuchBucket|ContainerNotFound|The specified bucket does not exist")


@contextmanager
def bucket_errors(url: str, key: str, *, writes: bool) -> Iterator[None]:
    """Raise what `Storage` promises in place of what obstore raises."""
    try:
        yield
    except (FileNotFoundError, BaseError) as error:
        raise _translated(url, key, error, writes) from error


def _translated(url: str, key: str, error: Exception, writes: bool) -> ServiceError:
    text, reason = str(error), _reason_of(error)
    if _NO_BUCKET.search(text):
        return StorageAwayError(
            f"expected a bucket at {url}, got {reason}; ask the operator to create the bucket or to correct "
            "PANOLOC_STORAGE",
            _RETRY_AFTER_S,
        )
    if isinstance(error, AlreadyExistsError | PreconditionError):
        return StoredFileChangedError(f"{key}: somebody else has replaced the file since it was read")
    if isinstance(error, FileNotFoundError):
        return missing(key)
    if _FULL.search(text):
        return StorageFullError(
            f"expected room in the bucket {url}, got {reason}; ask the operator for space", _RETRY_AFTER_S
        )
    if isinstance(error, PermissionDeniedError | UnauthenticatedError):
        kind, verb = (StorageReadOnlyError, "written") if writes else (StorageAwayError, "read")
        return kind(
            f"expected a bucket {url} that can be {verb}, got {reason}; ask the operator to check the key and its "
            "rights",
            _RETRY_AFTER_S,
        )
    return StorageAwayError(
        f"expected an answer from the bucket {url}, got {reason}; try again, or ask the operator to check the "
        "endpoint and the network",
        _RETRY_AFTER_S,
    )


def _reason_of(error: Exception) -> str:
    """Return in one line what a bucket answered."""
    text = str(error)
    code = _CODE.search(text)
    first = text.splitlines()[0][:_LONGEST_REASON] if text else type(error).__name__
    return f"{code[1] or code[2]} ({first})" if code else first
