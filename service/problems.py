"""From exceptions to HTTP problems (RFC 9457): those of `core`, and the documents made from all of them."""

from http import HTTPStatus
from typing import Any

from panoloc.core import errors as core
from panoloc.core.image.image_header import KNOWN_FORMATS as IMAGE_FORMATS
from panoloc.core.scan.format_detection import KNOWN_FORMATS as SCAN_FORMATS
from panoloc.service.errors import (
    EXPECTED_ERRORS,
    INTERNAL,
    INVALID,
    MALFORMED,
    InvalidOptionsError,
    Problem,
    ServiceError,
    WorkerError,
)

MEDIA_TYPE = "application/problem+json"

_BAD_SCAN = Problem(
    "scan-unusable", "The scan cannot become a map", 422, "Export the scan again, as described in the detail."
)
_BAD_IMAGE = Problem(
    "image-unusable", "The image cannot be localized", 422, "Send an image as the detail describes it.", "image"
)
_SEND_A_FORMAT = f"Send {IMAGE_FORMATS}."

CORE_PROBLEMS: dict[type[core.CoreError], Problem] = {
    core.CoreError: INTERNAL,
    core.ScanError: _BAD_SCAN,
    core.ScanFormatError: Problem(
        "unknown-scan-format", "Not a scan of a known format", 415, f"Upload {SCAN_FORMATS}."
    ),
    core.ScanDamagedError: Problem("scan-damaged", "The scan is damaged", 422, "Export or upload the scan again."),
    core.ScanContentError: _BAD_SCAN,
    core.ScanTooLargeError: Problem(
        "too-many-points", "The scan has too many points", 413, "Thin the scan before uploading."
    ),
    core.PanoramaError: _BAD_IMAGE,
    core.PanoramaFormatError: Problem(
        "unknown-image-format", "Not an image of a known format", 415, _SEND_A_FORMAT, "image"
    ),
    core.MaskFormatError: Problem(
        "unknown-mask-format", "The mask is not an image of a known format", 415, _SEND_A_FORMAT, "mask"
    ),
    core.PanoramaDamagedError: Problem(
        "image-damaged", "The image is damaged", 422, "Send the image again, whole.", "image"
    ),
    core.MaskDamagedError: Problem("mask-damaged", "The mask is damaged", 422, "Send the mask again, whole.", "mask"),
    core.PanoramaTooLargeError: Problem(
        "too-many-pixels", "The image has too many pixels", 413, "Scale the image down.", "image"
    ),
    core.MaskTooLargeError: Problem(
        "mask-too-many-pixels", "The mask has too many pixels", 413, "Scale the mask down.", "mask"
    ),
    core.PanoramaShapeError: Problem(
        "not-a-panorama", "The image is not a full-sphere panorama", 422, "Send a 2:1 equirectangular image.", "image"
    ),
    core.MaskShapeError: Problem(
        "mask-unusable",
        "The mask does not fit the panorama",
        422,
        "Send a mask of the panorama's shape that leaves some pixels visible.",
        "mask",
    ),
    core.PanoramaUnusableError: _BAD_IMAGE,
    core.OptionsError: INVALID,
    core.ExportRefusedError: Problem(
        "export-refused",
        "The photos cannot be written in this format",
        422,
        "Choose another format, or add the data named in the detail.",
    ),
    core.IndexFormatError: Problem(
        "index-unreadable", "The map's index cannot be read", 500, "Delete it from Redis; the service rebuilds it."
    ),
    core.DeadlineExceededError: Problem(
        "deadline-passed", "No answer before the deadline", 504, "Allow more time, or narrow the search with hints."
    ),
}

HTTP_PROBLEMS: dict[int, Problem] = {
    400: MALFORMED,
    404: Problem("no-such-path", "There is nothing at this path", 404, "See /docs for the paths."),
    405: Problem("method-not-allowed", "The path does not support this method", 405, "See Allow, or /docs."),
    431: Problem("head-too-large", "The path and headers are too large", 431, "Send long values in the body."),
    500: INTERNAL,
}


def problem_of(error: BaseException) -> Problem:
    """Return the kind of problem of any exception; an unexpected one is an internal error."""
    if isinstance(error, ServiceError):
        return error.problem
    return next((CORE_PROBLEMS[kind] for kind in type(error).__mro__ if kind in CORE_PROBLEMS), INTERNAL)


def problem_document(error: BaseException, request_id: str) -> dict[str, Any]:
    """Return the problem document of an exception. The message of an unexpected one goes to the log alone."""
    expected = isinstance(error, EXPECTED_ERRORS) and not isinstance(error, WorkerError)
    detail = str(error) if expected else "unexpected error: report it with the request id; the log has details"
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
    of_service = (kind.problem for kind in _with_subclasses(ServiceError))
    return {each.slug: each for each in (*of_service, *CORE_PROBLEMS.values(), *HTTP_PROBLEMS.values())}


def error_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI `responses` of a path that may answer these statuses, with the kinds behind each."""
    # A path that asks for a key slows down those who try some.
    tries_of_keys = {429} if 401 in statuses else set()
    return {status: _response(status) for status in sorted({*statuses, *tries_of_keys, 500})}


def _with_subclasses(kind: type[ServiceError]) -> list[type[ServiceError]]:
    return [kind, *(each for child in kind.__subclasses__() for each in _with_subclasses(child))]


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
