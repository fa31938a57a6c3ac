"""What can go wrong in `service`, one class per thing that a caller can act on.

    ServiceError
    ├── RequestError       the caller has to change the request
    ├── TryAgainError      nothing is wrong with the request; `retry_after_s` says when to come back
    ├── StorageError       what was stored cannot be read back
    ├── ExportFailedError  the process that writes exports, or looks for changes, failed
    └── WorkerError        a worker met a fault that nobody raises on purpose

What is wrong with a scan, an image or the options of a search is an exception of `panoloc.core.errors`, in every
process.

Every message says what was expected, what came, and what to do. Each class says which HTTP problem it is.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

from panoloc.core.errors import CoreError


@dataclass(frozen=True)
class Problem:
    """A kind of problem (RFC 9457). slug: stable, the end of its `type`. advice: for callers. part: the upload at
    fault."""

    slug: str
    title: str
    status: int
    advice: str
    part: str | None = None

    @property
    def type(self) -> str:
        """Return the URI of the kind, relative to the service, where it is explained."""
        return f"/problems/{self.slug}"


INTERNAL = Problem("internal-error", "The service failed", 500, "Report it with the request id; the log has details.")
MALFORMED = Problem("malformed-request", "The request cannot be read", 400, "Send what the API's description asks for.")
INVALID = Problem("invalid-options", "The request cannot be used as it is", 422, "Correct the named fields.")
_LATER = "Send it again after Retry-After seconds."


class ServiceError(Exception):
    """Base of everything that `service` raises on purpose."""

    problem: ClassVar[Problem] = INTERNAL


class RequestError(ServiceError):
    """The caller has to change the request."""


class MalformedRequestError(RequestError):
    """The request is not multipart, not JSON, or a part of it is missing."""

    problem = MALFORMED


class SlowBodyError(RequestError):
    """The body of the request comes too slowly."""

    problem = Problem("slow-body", "The request comes too slowly", 408, "Send it again over a faster connection.")


class KeyMissingError(RequestError):
    """The request has no API key, or an unknown one."""

    problem = Problem("key-missing", "An API key or a token is needed", 401, "Send `Authorization: Bearer KEY`.")


class ScopeMissingError(RequestError):
    """The API key may not do this."""

    problem = Problem("scope-missing", "The API key or token may not do this", 403, "Use one with the named scope.")


class HostCheckError(RequestError):
    """The page of another site made a browser ask, or the request names a host that is not ours."""

    problem = Problem(
        "foreign-page", "The request comes from a page of another site", 403, "Use an address or an allowed name."
    )


class MapNotFoundError(RequestError):
    """There is no map under this id or tag."""

    problem = Problem("map-not-found", "There is no such map", 404, "List the maps with GET /maps.")


class LocalizationNotFoundError(RequestError):
    """There is no localization under this id, or its time is over."""

    problem = Problem("localization-not-found", "There is no such localization", 404, "Localize again; answers expire.")


class NoPoseError(RequestError):
    """The image fits no place, or none of which the protocol has a pose."""

    problem = Problem(
        "no-pose", "The image has no pose on Earth", 404, "Send another image, or POST /localize for a pose in a map."
    )


class ObjectNotFoundError(RequestError):
    """No object that changed has this id, or it is found no longer."""

    problem = Problem("object-not-found", "There is no such object", 404, "List the changes of the map again.")


class BatchNotFoundError(RequestError):
    """There is no batch under this id, or no image of this number in it."""

    problem = Problem(
        "batch-not-found", "There is no such batch, or no such image in it", 404, "Send the images again."
    )


class KeyReusedError(RequestError):
    """An `Idempotency-Key` is of another request."""

    problem = Problem("idempotency-key-reused", "The key is of another request", 422, "Use a new Idempotency-Key.")


class BatchLimitError(RequestError):
    """There are as many batches as allowed."""

    problem = Problem("batch-limit", "The limit of batches is reached", 409, "Delete a batch.")


class ArchiveError(RequestError):
    """An uploaded zip cannot be unpacked, or must not be."""

    problem = Problem(
        "archive-unusable",
        "The archive cannot be unpacked",
        422,
        "Pack the images alone into a zip, and send it again.",
    )


class MapNotReadyError(RequestError):
    """The map is still being built."""

    problem = Problem(
        "map-not-ready", "The map is still being built", 409, "Poll the map and try again once it is ready."
    )

    def __init__(self, message: str, retry_after_s: int = 1) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class MapUnusableError(RequestError):
    """The map could not be built and no earlier revision serves."""

    problem = Problem("map-failed", "The map could not be built", 409, "Read the map's error; upload a new scan.")


class MapLimitError(RequestError):
    """There are as many maps as allowed."""

    problem = Problem("map-limit", "The limit of maps is reached", 409, "Delete a map, or raise the limit.")


class VersionConflictError(RequestError):
    """Somebody else has changed what the caller wants to change."""

    problem = Problem(
        "version-conflict", "Somebody else has changed the map", 412, "Read the map again, and send its version."
    )


class RegistrationLimitError(RequestError):
    """The registration of a scan took more time, memory or attempts than allowed."""

    problem = Problem(
        "registration-limit",
        "The scan takes more time or memory than allowed",
        422,
        "Thin the scan, or export it in another format.",
    )


class UploadTooLargeError(RequestError):
    """The upload has more bytes than allowed."""

    problem = Problem("upload-too-large", "The upload is too large", 413, "Send fewer bytes.")


class InvalidOptionsError(RequestError):
    """Options or parameters that cannot be used: out of their range, or contradicting each other.

    fields: one `{"field": "hints.radius_m", "message": "…"}` for each that is wrong.
    """

    problem = INVALID

    def __init__(self, message: str, fields: list[dict[str, Any]] | None = None) -> None:
        super().__init__(message)
        self.fields = fields or []

    @classmethod
    def of(cls, field: str, message: str) -> Self:
        """Return the error for one field."""
        return cls(f"{field}: {message}", [{"field": field, "message": message}])


class TryAgainError(ServiceError):
    """Nothing is wrong with the request; it is worth sending again after `retry_after_s` seconds."""

    problem = Problem("try-again", "The service cannot take this request now", 503, _LATER)

    def __init__(self, message: str, retry_after_s: int = 2) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class QueueFullError(TryAgainError):
    """The queue is full, or those that wait take longer than this one can wait. limit: which of the two."""

    problem = Problem("queue-full", "Too many requests wait", 429, _LATER)

    def __init__(self, message: str, retry_after_s: int = 2, limit: Literal["queue", "deadline"] = "queue") -> None:
        super().__init__(message, retry_after_s)
        self.limit: Literal["queue", "deadline"] = limit


class RequestUnderWayError(TryAgainError):
    """The same request, by its `Idempotency-Key`, is still being answered."""

    problem = Problem("request-under-way", "The same request is still being answered", 409, _LATER)


class BytesInFlightError(TryAgainError):
    """Uploads in memory have as many bytes as allowed."""

    problem = Problem("bytes-in-flight", "Too many bytes of uploads are in memory", 503, _LATER)


class UploadsError(TryAgainError):
    """There are as many uploads at the same time as allowed."""

    problem = Problem("too-many-uploads", "Too many uploads at the same time", 503, _LATER)


class RateError(TryAgainError):
    """One caller asks more often than callers may, or sends more."""

    problem = Problem(
        "too-often", "This caller exceeds its rate", 429, "Send fewer requests; wait for Retry-After seconds."
    )


class WrongKeysError(TryAgainError):
    """One address sent many unknown API keys."""

    problem = Problem(
        "wrong-keys", "Too many unknown API keys", 429, "Ask the operator for a key; wait for Retry-After seconds."
    )


class NoWorkerError(TryAgainError):
    """No worker can take the request now."""

    problem = Problem("no-worker", "No worker can take this request now", 503, _LATER)


class CacheDownError(TryAgainError):
    """Redis does not answer."""

    problem = Problem("cache-down", "Redis does not answer", 503, _LATER)


class StorageFullError(TryAgainError):
    """There is no space left for uploads."""

    problem = Problem("storage-full", "There is no space left", 503, "Ask the operator for space; try again.")


class StorageReadOnlyError(TryAgainError):
    """The data folder or the bucket cannot be written."""

    problem = Problem("storage-read-only", "The storage cannot be written", 503, "Ask the operator; try again.")


class StorageAwayError(TryAgainError):
    """The bucket does not answer, or lets nobody in."""

    problem = Problem("storage-away", "The storage does not answer", 503, _LATER)


class StorageError(ServiceError):
    """What was stored cannot be read back."""

    problem = Problem("storage-damaged", "A stored file cannot be used", 500, "Restore a backup or upload it again.")


class StoredFileMissingError(StorageError):
    """Nothing is stored under this key."""


class StoredFileDamagedError(StorageError):
    """The stored bytes do not match their digest."""


class StoredFileChangedError(StorageError):
    """Something else is stored than what was to be replaced: another process has been faster."""


class ExportFailedError(ServiceError):
    """The process that writes exports, or looks for changes, failed."""

    problem = INTERNAL


class WorkerError(ServiceError):
    """A worker met a fault of its own. kind: the name of the exception's class; the message is the original one."""

    problem = INTERNAL

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[type["WorkerError"], tuple[str, str]]:
        return WorkerError, (self.kind, str(self))


EXPECTED_ERRORS = (ServiceError, CoreError)
"""The bases of everything that is raised on purpose: their messages are for callers."""
