"""Problem documents as HTTP responses."""

from starlette.responses import JSONResponse

from service.errors import KeyMissingError, MalformedRequestError, MapNotReadyError, TryAgainError, UploadTooLargeError
from service.problems import MEDIA_TYPE, Problem, document_with, problem_document, problem_of

_RETRY_AFTER_S = 2


def problem_response(error: BaseException, request_id: str) -> JSONResponse:
    """Return the response for any exception, with the headers that its status asks for."""
    problem = problem_of(error)
    headers: dict[str, str] = {}
    if isinstance(error, TryAgainError | MapNotReadyError):
        headers["Retry-After"] = str(error.retry_after_s)
    elif problem.status in (429, 503):
        headers["Retry-After"] = str(_RETRY_AFTER_S)
    if isinstance(error, KeyMissingError):
        headers["WWW-Authenticate"] = 'Bearer realm="panoloc"'
    if isinstance(error, UploadTooLargeError | MalformedRequestError) or problem.status in (413, 415):
        # The rest of the body is not read.
        headers["Connection"] = "close"
    return JSONResponse(problem_document(error, request_id), problem.status, headers, MEDIA_TYPE)


def plain_problem_response(
    problem: Problem, detail: str, request_id: str, headers: dict[str, str] | None = None
) -> JSONResponse:
    """Return the response for a problem without an exception of ours behind it."""
    return JSONResponse(document_with(problem, detail, request_id), problem.status, headers, MEDIA_TYPE)
