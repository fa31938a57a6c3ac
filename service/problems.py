"""From exceptions to HTTP problems (RFC 9457): the one table, and the documents made from it."""

from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from core import errors as core
from core.panorama.image_header import KNOWN_FORMATS as IMAGE_FORMATS
from core.scan.format_detection import KNOWN_FORMATS as SCAN_FORMATS
from service import errors as service
from service.errors import EXPECTED_ERRORS, InvalidOptionsError, WorkerError

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
_NOT_A_SCAN = Problem("unknown-scan-format", "Not a scan of a known format", 415, f"Upload {SCAN_FORMATS}.")
_BAD_SCAN = Problem("scan-unusable", "The scan cannot become a map", 422, "Export the scan again, as the detail says.")
_DAMAGED_SCAN = Problem("scan-damaged", "The scan is damaged", 422, "Export or upload the scan again.")
_NOT_AN_IMAGE = Problem(
    "unknown-image-format", "Not an image of a known format", 415, f"Send {IMAGE_FORMATS}.", "image"
)
_MANY_PIXELS = Problem("too-many-pixels", "The image has too many pixels", 413, "Scale the image down.", "image")
_BAD_IMAGE = Problem(
    "image-unusable", "The image cannot be localized", 422, "Send an image as the detail describes it.", "image"
)
_UNKNOWN_MASK = Problem(
    "unknown-mask-format", "The mask is not an image of a known format", 415, f"Send {IMAGE_FORMATS}.", "mask"
)
_LARGE_MASK = Problem("mask-too-many-pixels", "The mask has too many pixels", 413, "Scale the mask down.", "mask")

PROBLEMS: dict[type[Exception], Problem] = {
    service.ServiceError: _INTERNAL,
    service.RequestError: _MALFORMED,
    service.MalformedRequestError: _MALFORMED,
    service.SlowBodyError: Problem(
        "slow-body", "The request comes too slowly", 408, "Send it again over a better connection."
    ),
    service.KeyMissingError: Problem(
        "key-missing", "An API key or a token is needed", 401, "Send `Authorization: Bearer KEY`."
    ),
    service.ScopeMissingError: Problem(
        "scope-missing", "The API key or token may not do this", 403, "Use one with the scope named."
    ),
    service.HostCheckError: Problem(
        "foreign-page", "The request comes from the page of another site", 403, "Use an address or an allowed name."
    ),
    service.MapNotFoundError: Problem("map-not-found", "There is no such map", 404, "List the maps with GET /maps."),
    service.LocalizationNotFoundError: Problem(
        "localization-not-found",
        "There is no such localization",
        404,
        "Localize again; answers live for a limited time.",
    ),
    service.NoPoseError: Problem(
        "no-pose",
        "The image has no pose on Earth",
        404,
        "Send another image, or POST /localize for a pose in a map.",
    ),
    service.BatchNotFoundError: Problem(
        "batch-not-found", "There is no such batch", 404, "Send the images again; batches live until they are deleted."
    ),
    service.BatchLimitError: Problem(
        "batch-limit", "There are as many batches as allowed", 409, "Delete a batch, or raise the limit."
    ),
    service.ArchiveError: Problem(
        "archive-unusable",
        "The archive cannot be unpacked",
        422,
        "Pack the images alone into a zip, and send it again.",
    ),
    service.MapNotReadyError: Problem(
        "map-not-ready", "The map is still being built", 409, "Poll the map and try again once it is ready."
    ),
    service.MapUnusableError: Problem(
        "map-failed", "The map could not be built", 409, "Read the map's error; upload a new scan."
    ),
    service.MapLimitError: Problem(
        "map-limit", "There are as many maps as allowed", 409, "Delete a map, or raise the limit."
    ),
    service.VersionConflictError: Problem(
        "version-conflict", "Somebody else has changed the map", 412, "Read the map again, and send its version."
    ),
    service.RegistrationLimitError: Problem(
        "registration-limit",
        "The scan takes more time or memory than allowed",
        422,
        "Thin the scan, or export it in another format.",
    ),
    service.UploadTooLargeError: Problem("upload-too-large", "The upload is too large", 413, "Send fewer bytes."),
    service.InvalidOptionsError: _INVALID,
    service.UnwantedPartError: _INVALID,
    service.TryAgainError: _BUSY,
    service.QueueFullError: Problem(
        "queue-full", "Too many requests wait", 429, "Send it again after Retry-After seconds."
    ),
    service.BytesInFlightError: Problem(
        "bytes-in-flight", "Too many bytes of uploads are in memory", 503, "Send it again after Retry-After seconds."
    ),
    service.UploadsError: Problem(
        "too-many-uploads", "Too many uploads at the same time", 503, "Send it again after Retry-After seconds."
    ),
    service.RateError: Problem(
        "too-often", "This caller asks for too much", 429, "Ask less often; wait for Retry-After seconds."
    ),
    service.WrongKeysError: Problem(
        "wrong-keys", "Too many unknown API keys", 429, "Ask the operator for a key; wait for Retry-After seconds."
    ),
    service.NoWorkerError: Problem(
        "no-worker", "No worker can take this now", 503, "Send it again after Retry-After seconds."
    ),
    service.CacheDownError: Problem(
        "cache-down", "Redis does not answer", 503, "Send it again after Retry-After seconds."
    ),
    service.StorageFullError: Problem(
        "storage-full", "There is no space left", 503, "Ask the operator for space; try again."
    ),
    service.StorageReadOnlyError: Problem(
        "storage-read-only", "The storage cannot be written", 503, "Ask the operator; try again."
    ),
    service.StorageAwayError: Problem(
        "storage-away", "The storage does not answer", 503, "Send it again after Retry-After seconds."
    ),
    service.StorageError: _STORAGE,
    service.StoredFileMissingError: _STORAGE,
    service.StoredFileDamagedError: _STORAGE,
    service.StoredFileChangedError: _STORAGE,
    service.ExportFailedError: _INTERNAL,
    service.WorkerError: _INTERNAL,
    core.CoreError: _INTERNAL,
    core.ScanError: _BAD_SCAN,
    core.ScanFormatError: _NOT_A_SCAN,
    core.ScanDamagedError: _DAMAGED_SCAN,
    core.ScanContentError: _BAD_SCAN,
    core.ScanTooLargeError: Problem(
        "too-many-points", "The scan has too many points", 413, "Thin the scan before uploading."
    ),
    core.PanoramaError: _BAD_IMAGE,
    core.PanoramaFormatError: _NOT_AN_IMAGE,
    core.MaskFormatError: _UNKNOWN_MASK,
    core.PanoramaDamagedError: Problem(
        "image-damaged", "The image is damaged", 422, "Send the image again, whole.", "image"
    ),
    core.MaskDamagedError: Problem("mask-damaged", "The mask is damaged", 422, "Send the mask again, whole.", "mask"),
    core.PanoramaTooLargeError: _MANY_PIXELS,
    core.MaskTooLargeError: _LARGE_MASK,
    core.PanoramaShapeError: Problem(
        "not-a-panorama", "The image is not a full-sphere panorama", 422, "Send a 2:1 equirectangular image.", "image"
    ),
    core.MaskShapeError: Problem(
        "mask-unusable",
        "The mask does not fit the panorama",
        422,
        "Send a mask of the panorama's shape that leaves some of it.",
        "mask",
    ),
    core.PanoramaUnusableError: _BAD_IMAGE,
    core.OptionsError: _INVALID,
    core.ExportRefusedError: Problem(
        "export-refused",
        "The photos cannot be written in this format",
        422,
        "Choose another format, or add what the detail names.",
    ),
    core.IndexFormatError: Problem(
        "index-unreadable", "The map's index cannot be read", 500, "Delete it from Redis; it is built again."
    ),
    core.DeadlineExceededError: _DEADLINE,
}

HTTP_PROBLEMS: dict[int, Problem] = {
    400: _MALFORMED,
    404: Problem("no-such-path", "There is nothing at this path", 404, "See /docs for the paths."),
    405: Problem("method-not-allowed", "The path does not know this method", 405, "See Allow, or /docs."),
    431: Problem("head-too-large", "The path and headers are too large", 431, "Send what is large in the body."),
    500: _INTERNAL,
}


def problem_of(error: BaseException) -> Problem:
    """Return the kind of problem of any exception; one that nobody expected is an internal error."""
    return next((PROBLEMS[kind] for kind in type(error).__mro__ if kind in PROBLEMS), _INTERNAL)


def problem_document(error: BaseException, request_id: str) -> dict[str, Any]:
    """Return the problem document of an exception. What nobody expected is not told to the caller, but logged."""
    expected = isinstance(error, EXPECTED_ERRORS) and not isinstance(error, WorkerError)
    detail = str(error) if expected else "an unexpected fault: report it with the request id, the log says more"
    document = document_with(problem_of(error), detail, request_id)
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
    # Whoever asks for a key slows down those who try some.
    tries_of_keys = {429} if 401 in statuses else set()
    return {status: _response(status) for status in sorted({*statuses, *tries_of_keys, 500})}


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
