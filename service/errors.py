"""What can go wrong in `service`, one class per thing that a caller can act on.

    ServiceError
    ├── RequestError                  the caller has to change the request
    │   ├── MalformedRequestError     not multipart, not JSON, or a part is missing
    │   ├── SlowBodyError             the body comes too slowly
    │   ├── KeyMissingError           no key, or an unknown one
    │   ├── ScopeMissingError         the key may not do this
    │   ├── HostCheckError            the page of another site made a browser ask
    │   ├── MapNotFoundError          no map under this id or tag
    │   ├── LocalizationNotFoundError no localization under this id, or its time is over
    │   ├── NoPoseError               the image fits no place of which its protocol has a pose
    │   ├── BatchNotFoundError        no batch under this id
    │   ├── BatchLimitError           as many batches as allowed
    │   ├── ArchiveError              an uploaded zip that cannot be unpacked, or must not be
    │   ├── MapNotReadyError          the map is still being built
    │   ├── MapUnusableError          the map could not be built and serves nothing
    │   ├── MapLimitError             as many maps as allowed
    │   ├── VersionConflictError      somebody else has changed the map since the caller read it
    │   ├── RegistrationLimitError    the scan takes more time, memory or attempts than allowed
    │   ├── UploadTooLargeError       too many bytes
    │   └── InvalidOptionsError       options or query parameters out of their range; `fields` names them
    │       └── UnwantedPartError     a part of an upload that nobody takes, or one too many
    ├── TryAgainError                 nothing is wrong with the request; `retry_after_s` says when to come back
    │   ├── QueueFullError            as many requests wait as may
    │   ├── BytesInFlightError        as many bytes of uploads lie in memory as may
    │   ├── UploadsError              as many uploads come as may
    │   ├── RateError                 one caller asks too often, or sends too much
    │   ├── WrongKeysError            many unknown API keys from one address
    │   ├── NoWorkerError             no worker is up
    │   ├── CacheDownError            Redis does not answer
    │   ├── StorageFullError          the disk or the bucket is full
    │   ├── StorageReadOnlyError      the data folder or the bucket cannot be written
    │   └── StorageAwayError          the bucket does not answer, or lets nobody in
    ├── StorageError                  what was stored cannot be read back
    │   ├── StoredFileMissingError    nothing under this key
    │   ├── StoredFileDamagedError    the bytes do not match their digest
    │   └── StoredFileChangedError    something else is there than what was to be replaced
    ├── ExportFailedError             the process that writes exports failed
    └── WorkerError                   a worker met a fault that nobody raises on purpose

What is wrong with a scan, an image or the options of a search is an exception of `core.errors`, in every process.

Every message says what was expected, what came, and what to do. `service.problems` turns each class into an HTTP
problem; a class without a row there fails a test.
"""

from typing import Any, Literal

from core.errors import CoreError


class ServiceError(Exception):
    """Base of everything that `service` raises on purpose."""


class RequestError(ServiceError):
    """The caller has to change the request."""


class MalformedRequestError(RequestError):
    """The request is not multipart, not JSON, or a part of it is missing."""


class SlowBodyError(RequestError):
    """The body of the request comes too slowly."""


class KeyMissingError(RequestError):
    """The request bears no API key, or one that nobody knows."""


class ScopeMissingError(RequestError):
    """The API key may not do this."""


class HostCheckError(RequestError):
    """The page of another site made a browser ask, or the request names a host that is not ours."""


class MapNotFoundError(RequestError):
    """There is no map under this id or tag."""


class LocalizationNotFoundError(RequestError):
    """There is no localization under this id, or its time is over."""


class NoPoseError(RequestError):
    """The image fits no place, or none of which the protocol has a pose."""


class BatchNotFoundError(RequestError):
    """There is no batch under this id."""


class BatchLimitError(RequestError):
    """There are as many batches as allowed."""


class ArchiveError(RequestError):
    """An uploaded zip cannot be unpacked, or must not be."""


class MapNotReadyError(RequestError):
    """The map is still being built."""

    def __init__(self, message: str, retry_after_s: int = 1) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class MapUnusableError(RequestError):
    """The map could not be built and no earlier revision serves."""


class MapLimitError(RequestError):
    """There are as many maps as allowed."""


class VersionConflictError(RequestError):
    """Somebody else has changed what the caller wants to change."""


class RegistrationLimitError(RequestError):
    """The registration of a scan took more time, memory or attempts than allowed."""


class UploadTooLargeError(RequestError):
    """The upload has more bytes than allowed."""


class InvalidOptionsError(RequestError):
    """Options or parameters are out of their range.

    fields: one `{"field": "hints.radius_m", "message": "…"}` per mistake.
    """

    def __init__(self, message: str, fields: list[dict[str, Any]] | None = None) -> None:
        super().__init__(message)
        self.fields = fields or []


class UnwantedPartError(InvalidOptionsError):
    """The upload has a part that nobody takes, or one too many; the rest of it is not read."""


class TryAgainError(ServiceError):
    """Nothing is wrong with the request; it is worth sending again after `retry_after_s` seconds."""

    def __init__(self, message: str, retry_after_s: int = 2) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class QueueFullError(TryAgainError):
    """As many requests wait as may, or those that wait take longer than this one can wait. limit: which of the two."""

    def __init__(self, message: str, retry_after_s: int = 2, limit: Literal["queue", "deadline"] = "queue") -> None:
        super().__init__(message, retry_after_s)
        self.limit: Literal["queue", "deadline"] = limit


class BytesInFlightError(TryAgainError):
    """As many bytes of uploads lie in memory as may."""


class UploadsError(TryAgainError):
    """As many scans and batches are uploaded as may be at the same time."""


class RateError(TryAgainError):
    """One caller asks more often than callers may, or sends more."""


class WrongKeysError(TryAgainError):
    """One address sent many API keys that nobody knows."""


class NoWorkerError(TryAgainError):
    """No worker can take the request now."""


class CacheDownError(TryAgainError):
    """Redis does not answer."""


class StorageFullError(TryAgainError):
    """There is no space left for uploads."""


class StorageReadOnlyError(TryAgainError):
    """The data folder or the bucket cannot be written."""


class StorageAwayError(TryAgainError):
    """The bucket does not answer, or lets nobody in."""


class StorageError(ServiceError):
    """What was stored cannot be read back."""


class StoredFileMissingError(StorageError):
    """Nothing is stored under this key."""


class StoredFileDamagedError(StorageError):
    """The stored bytes do not match their digest."""


class StoredFileChangedError(StorageError):
    """Something else is stored than what was to be replaced: somebody has been faster."""


class ExportFailedError(ServiceError):
    """The process that writes exports failed."""


class WorkerError(ServiceError):
    """A worker met a fault of its own. kind: the name of the exception's class; the message is the original one."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[type["WorkerError"], tuple[str, str]]:
        return WorkerError, (self.kind, str(self))


EXPECTED_ERRORS = (ServiceError, CoreError)
"""The bases of everything that is raised on purpose: what callers are told."""
