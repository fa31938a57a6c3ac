"""From exceptions to HTTP problems (RFC 9457): the one table, and the documents made from it.

Exceptions of `core` are known by the names of their classes, because routes do not import `core`.
"""

from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from service.errors import InvalidOptionsError, ServiceError, WorkerError

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True)
class Problem:
    """A kind of problem. slug: stable, the end of its `type`. advice: what a caller does about it. part: the upload at fault."""

    slug: str
    title: str
    status: int
    advice: str
    part: str | None = None

    @property
    def type(self) -> str:
        """Return the URI of the kind, relative to the service, where it is explained."""
        return f"/problems/{self.slug}"


_MALFORMED = Problem(
    "malformed-request", "The request cannot be read", 400, "Send what the API's description asks for."
)
_INVALID = Problem("invalid-options", "Options are out of their range", 422, "Correct the fields that are named.")
_INTERNAL = Problem("internal-error", "The service failed", 500, "Report it with the request id; the log says more.")
_STORAGE = Problem(
    "storage-damaged", "A stored file cannot be used", 500, "Restore it from a backup or upload it again."
)
_BUSY = Problem("try-again", "The service cannot take this now", 503, "Send it again after Retry-After seconds.")
_DEADLINE = Problem(
    "deadline-passed", "No answer before the deadline", 504, "Allow more time, or narrow it with hints."
)
_NOT_A_SCAN = Problem(
    "unknown-scan-format", "Not a scan of a known format", 415, "Upload PLY, PCD, LAS, LAZ, E57 or text."
)
_BAD_SCAN = Problem("scan-unusable", "The scan cannot become a map", 422, "Export the scan again, as the detail says.")
_DAMAGED_SCAN = Problem("scan-damaged", "The scan is damaged", 422, "Export or upload the scan again.")
_NOT_AN_IMAGE = Problem(
    "unknown-image-format", "Not an image of a known format", 415, "Send JPEG, PNG or WebP.", "image"
)
_MANY_PIXELS = Problem("too-many-pixels", "The image has too many pixels", 413, "Scale the image down.", "image")
_BAD_IMAGE = Problem(
    "image-unusable", "The image cannot be localized", 422, "Send an image as the detail describes it.", "image"
)
_UNKNOWN_MASK = Problem(
    "unknown-mask-format", "The mask is not an image of a known format", 415, "Send JPEG, PNG or WebP.", "mask"
)
_LARGE_MASK = Problem("mask-too-many-pixels", "The mask has too many pixels", 413, "Scale the mask down.", "mask")

PROBLEMS: dict[str, Problem] = {
    # service
    "ServiceError": _INTERNAL,
    "RequestError": _MALFORMED,
    "MalformedRequestError": _MALFORMED,
    "KeyMissingError": Problem("key-missing", "An API key is needed", 401, "Send `Authorization: Bearer KEY`."),
    "ScopeMissingError": Problem(
        "scope-missing", "The API key may not do this", 403, "Use a key with the scope named."
    ),
    "MapNotFoundError": Problem("map-not-found", "There is no such map", 404, "List the maps with GET /maps."),
    "LocalizationNotFoundError": Problem(
        "localization-not-found",
        "There is no such localization",
        404,
        "Localize again; answers live for a limited time.",
    ),
    "MapNotReadyError": Problem(
        "map-not-ready", "The map is still being built", 409, "Poll the map and try again once it is ready."
    ),
    "MapUnusableError": Problem(
        "map-failed", "The map could not be built", 409, "Read the map's error; upload a new scan."
    ),
    "MapLimitError": Problem(
        "map-limit", "There are as many maps as allowed", 409, "Delete a map, or raise the limit."
    ),
    "UploadTooLargeError": Problem("upload-too-large", "The upload is too large", 413, "Send fewer bytes."),
    "ImageTooLargeError": _MANY_PIXELS,
    "LargeMaskError": _LARGE_MASK,
    "TooManyPointsError": Problem(
        "too-many-points", "The scan has too many points", 413, "Thin the scan before uploading."
    ),
    "UnknownImageError": _NOT_AN_IMAGE,
    "UnknownMaskError": _UNKNOWN_MASK,
    "UnknownScanError": _NOT_A_SCAN,
    "DamagedScanError": _DAMAGED_SCAN,
    "InvalidOptionsError": _INVALID,
    "TryAgainError": _BUSY,
    "QueueFullError": Problem("queue-full", "Too many requests wait", 429, "Send it again after Retry-After seconds."),
    "NoWorkerError": Problem(
        "no-worker", "No worker can take this now", 503, "Send it again after Retry-After seconds."
    ),
    "CacheDownError": Problem("cache-down", "Redis does not answer", 503, "Send it again after Retry-After seconds."),
    "StorageFullError": Problem(
        "storage-full", "There is no space left", 503, "Ask the operator for space; try again."
    ),
    "DeadlineError": _DEADLINE,
    "StorageError": _STORAGE,
    "StoredFileMissingError": _STORAGE,
    "StoredFileDamagedError": _STORAGE,
    "WorkerError": _INTERNAL,
    # core
    "CoreError": _INTERNAL,
    "ScanError": _BAD_SCAN,
    "ScanFormatError": _NOT_A_SCAN,
    "ScanDamagedError": _DAMAGED_SCAN,
    "ScanContentError": _BAD_SCAN,
    "PanoramaError": _BAD_IMAGE,
    "PanoramaFormatError": _NOT_AN_IMAGE,
    "MaskFormatError": _UNKNOWN_MASK,
    "PanoramaDamagedError": Problem(
        "image-damaged", "The image is damaged", 422, "Send the image again, whole.", "image"
    ),
    "MaskDamagedError": Problem("mask-damaged", "The mask is damaged", 422, "Send the mask again, whole.", "mask"),
    "PanoramaTooLargeError": _MANY_PIXELS,
    "MaskTooLargeError": _LARGE_MASK,
    "PanoramaShapeError": Problem(
        "not-a-panorama", "The image is not a full-sphere panorama", 422, "Send a 2:1 equirectangular image.", "image"
    ),
    "MaskShapeError": Problem(
        "mask-unusable",
        "The mask does not fit the panorama",
        422,
        "Send a mask of the panorama's shape that leaves some of it.",
        "mask",
    ),
    "OptionsError": _INVALID,
    "IndexFormatError": Problem(
        "index-unreadable", "The map's index cannot be read", 500, "Delete it from Redis; it is built again."
    ),
    "DeadlineExceededError": _DEADLINE,
    "CancelledError": _BUSY,
}

HTTP_PROBLEMS: dict[int, Problem] = {
    400: _MALFORMED,
    404: Problem("no-such-path", "There is nothing at this path", 404, "See /docs for the paths."),
    405: Problem("method-not-allowed", "The path does not know this method", 405, "See Allow, or /docs."),
    500: _INTERNAL,
}


def problem_of(error: BaseException) -> Problem:
    """Return the kind of problem of any exception; one that nobody expected is an internal error."""
    if isinstance(error, WorkerError):
        return PROBLEMS.get(error.kind, _INTERNAL)
    return PROBLEMS.get(type(error).__name__, _INTERNAL) if isinstance(error, ServiceError) else _INTERNAL


def problem_document(error: BaseException, request_id: str) -> dict[str, Any]:
    """Return the problem document of an exception. What nobody expected is not told to the caller, but logged."""
    problem = problem_of(error)
    expected = isinstance(error, ServiceError) and (problem is not _INTERNAL or not isinstance(error, WorkerError))
    detail = str(error) if expected else "an unexpected fault: report it with the request id, the log says more"
    document = document_with(problem, detail, request_id)
    if isinstance(error, InvalidOptionsError) and error.fields:
        document["fields"] = error.fields
    return document


def document_with(problem: Problem, detail: str, request_id: str) -> dict[str, Any]:
    """Return a problem document; one about an upload names its part among the `fields`."""
    document: dict[str, Any] = {
        "type": problem.type,
        "title": problem.title,
        "status": problem.status,
        "detail": detail,
        "request_id": request_id,
    }
    if problem.part is not None:
        document["fields"] = [{"field": problem.part, "message": detail}]
    return document


def known_problems() -> dict[str, Problem]:
    """Return every kind of problem by its slug."""
    return {problem.slug: problem for problem in (*PROBLEMS.values(), *HTTP_PROBLEMS.values())}


def error_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a path that may answer these statuses, with the kinds behind each."""
    return {status: _response(status) for status in (*statuses, 500)}


def _response(status: int) -> dict[str, Any]:
    kinds = [problem for problem in known_problems().values() if problem.status == status]
    examples = {
        kind.slug: {"summary": kind.title, "value": document_with(kind, kind.advice, "req_1f0c")} for kind in kinds
    }
    response: dict[str, Any] = {
        "description": "; ".join(kind.title for kind in kinds) or HTTPStatus(status).phrase,
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDocument"}, "examples": examples}},
    }
    if status in (429, 503):
        response["headers"] = {
            "Retry-After": {"description": "Seconds to wait", "required": True, "schema": {"type": "integer"}}
        }
    return response
