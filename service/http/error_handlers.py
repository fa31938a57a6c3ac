"""Turns every exception that a route may end with into a problem document."""

from typing import Any

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from service.errors import InvalidOptionsError, MalformedRequestError, ServiceError, WorkerError
from service.http.problem_response import plain_problem_response, problem_response
from service.http.request_context import current_request_id
from service.http.validation import mistakes_error
from service.problems import HTTP_PROBLEMS, Problem, problem_of

_log = structlog.get_logger(__name__)
_CLIENT_CLOSED_REQUEST = 499


def install_error_handlers(app: FastAPI) -> None:
    """Register the handlers; what none of them takes becomes a 500 in `service.http.request_context`."""
    handlers: dict[type[Exception], Any] = {
        ServiceError: _service_error,
        RequestValidationError: _validation_error,
        HTTPException: _http_exception,
        ClientDisconnect: _client_disconnect,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)


async def _service_error(request: Request, error: ServiceError) -> Response:
    if problem_of(error).status == 500:
        # What callers are not told, the log has to say.
        kind = error.kind if isinstance(error, WorkerError) else type(error).__name__
        _log.error("the service failed", kind=kind, error=str(error))
    return problem_response(error, current_request_id())


async def _validation_error(request: Request, error: RequestValidationError) -> Response:
    found: MalformedRequestError | InvalidOptionsError = mistakes_error(error.errors(), skip=1)
    return problem_response(found, current_request_id())


async def _http_exception(request: Request, error: HTTPException) -> Response:
    problem = HTTP_PROBLEMS.get(error.status_code) or Problem(
        "http-error", "The request cannot be answered", error.status_code, ""
    )
    detail = f"{problem.title}: got {request.method} {request.url.path[:200]}; {problem.advice}"
    return plain_problem_response(problem, detail, current_request_id(), dict(error.headers or {}))


async def _client_disconnect(request: Request, error: ClientDisconnect) -> Response:
    """Nobody reads it; the status is for log and metrics."""
    return Response(status_code=_CLIENT_CLOSED_REQUEST)
