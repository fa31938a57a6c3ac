"""Maps exceptions to responses with a problem document."""

from typing import Any

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from panoloc.service.errors import (
    EXPECTED_ERRORS,
    KeyMissingError,
    MapNotReadyError,
    Problem,
    TryAgainError,
    WorkerError,
)
from panoloc.service.http.validation import validation_error
from panoloc.service.problems import HTTP_PROBLEMS, MEDIA_TYPE, document_with, problem_document, problem_of

_METHODS = ("DELETE", "GET", "PATCH", "POST", "PUT")
_log = structlog.get_logger(__name__)
_CLIENT_CLOSED_REQUEST = 499


def install_error_handlers(app: FastAPI) -> None:
    """Register the handlers; `panoloc.service.http.request_context` answers 500 to any other exception."""
    handlers: dict[type[Exception], Any] = {
        **dict.fromkeys(EXPECTED_ERRORS, _expected_error),
        RequestValidationError: _validation_error,
        HTTPException: _http_exception,
        ClientDisconnect: _client_disconnect,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)


def problem_response(error: BaseException, request_id: str) -> JSONResponse:
    """Return the response for any exception, with the headers that its status asks for."""
    problem = problem_of(error)
    headers: dict[str, str] = {}
    if isinstance(error, TryAgainError | MapNotReadyError):
        headers["Retry-After"] = str(error.retry_after_s)
    if isinstance(error, KeyMissingError):
        headers["WWW-Authenticate"] = 'Bearer realm="panoloc"'
    return JSONResponse(problem_document(error, request_id), problem.status, headers, MEDIA_TYPE)


def plain_problem_response(
    problem: Problem, detail: str, request: Request, headers: dict[str, str] | None = None
) -> JSONResponse:
    """Return the response for a problem that is no exception of ours."""
    document = document_with(problem, detail, request.state.request_id)
    return JSONResponse(document, problem.status, headers, MEDIA_TYPE)


async def _expected_error(request: Request, error: Exception) -> Response:
    if problem_of(error).status == 500:
        # The log says what callers are not told.
        kind = error.kind if isinstance(error, WorkerError) else type(error).__name__
        _log.error("the service failed", kind=kind, error=str(error))
    return problem_response(error, request.state.request_id)


async def _validation_error(request: Request, error: RequestValidationError) -> Response:
    return problem_response(validation_error(error.errors(), skip=1), request.state.request_id)


async def _http_exception(request: Request, error: HTTPException) -> Response:
    problem = HTTP_PROBLEMS.get(error.status_code) or Problem(
        "http-error", "The request cannot be answered", error.status_code, ""
    )
    headers, expected = dict(error.headers or {}), "a path listed at /docs"
    if error.status_code == 405:
        methods = _methods_at(request)
        headers, expected = {**headers, "Allow": ", ".join(methods)}, f"{' or '.join(methods)} at this path"
    detail = f"expected {expected}, got {request.method} {request.url.path[:200]}"
    return plain_problem_response(problem, detail, request, headers)


def _methods_at(request: Request) -> list[str]:
    """Return the methods that a path has; the exception knows those of one route alone."""
    scopes = [{**request.scope, "method": method} for method in _METHODS]
    return [s["method"] for s in scopes if any(each.matches(s)[0] is Match.FULL for each in request.app.routes)]


async def _client_disconnect(request: Request, error: ClientDisconnect) -> Response:
    """Nobody reads it; the status is for log and metrics."""
    return Response(status_code=_CLIENT_CLOSED_REQUEST)
