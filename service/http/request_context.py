"""Around every request: its id, a log line, metrics, HEAD where GET is meant, and a problem document for heads too large
and for unexpected faults; and the last requests that ended in a problem, for operators."""

import asyncio
import json
import re
import time
from collections import deque
from collections.abc import Iterable
from typing import Any

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from panoloc.service.errors import NoWorkerError
from panoloc.service.http.error_handlers import plain_problem_response, problem_response
from panoloc.service.jobs import new_id, now
from panoloc.service.maps.record import MapRecord
from panoloc.service.metrics import Metrics
from panoloc.service.problems import HTTP_PROBLEMS, MEDIA_TYPE

_log = structlog.get_logger("service.requests")
_ACCEPTABLE_ID = re.compile(r"[A-Za-z0-9._~:+/=-]{1,128}")
_HEADER = "X-Request-ID"
_UNMATCHED = "unmatched"
_MOST_HEAD_BYTES = 16 * 1024  # of the path and all headers
_MOST_ERRORS = 50
_MOST_BYTES = 8192
_KEPT = ("type", "title", "status", "detail", "request_id")


class RecentErrors:
    """The newest problems of this process, with their time and request."""

    def __init__(self) -> None:
        self._errors: deque[dict[str, Any]] = deque(maxlen=_MOST_ERRORS)

    def note(self, method: str, path: str, content_type: str, body: bytes) -> None:
        """Keep a response when it is a problem document."""
        # The last piece of an answer may be empty.
        if content_type != MEDIA_TYPE or not body or len(body) > _MOST_BYTES:
            return
        self._errors.appendleft(_entry(now(), method, path, json.loads(body)))

    def newest(self, failed: Iterable[MapRecord] = ()) -> list[dict[str, Any]]:
        """Return them, newest first.

        failed: maps that could not be built. Their uploads were accepted, so no response reported the failure; they are
        listed as long as they exist.
        """
        of_maps = [_entry(each.updated_at, "POST", f"/maps/{each.id}", each.newest.error or {}) for each in failed]
        # All times have one format and one zone, so that their order is that of the text.
        return sorted([*self._errors, *of_maps], key=lambda entry: str(entry["at"]), reverse=True)[:_MOST_ERRORS]


def _entry(at: str, method: str, path: str, document: dict[str, Any]) -> dict[str, Any]:
    return {"at": at, "method": method, "path": path[:200], **{name: document.get(name) for name in _KEPT}}


class RequestContext:
    """ASGI middleware. An id that came with the request is kept when it is harmless to log, else replaced;
    `request.state` holds it."""

    def __init__(self, app: ASGIApp, metrics: Metrics, errors: RecentErrors) -> None:
        self._app = app
        self._metrics = metrics
        self._errors = errors

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get(_HEADER, "")
        request_id = given if _ACCEPTABLE_ID.fullmatch(given) else new_id("req")
        scope.setdefault("state", {})["request_id"] = request_id
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        began, status, content_type = time.monotonic(), 0, ""
        # Probes and browsers ask with HEAD for what GET would answer, without its body.
        is_head = scope["method"] == "HEAD"
        inner = {**scope, "method": "GET"} if is_head else scope

        async def send_with_id(message: Message) -> None:
            nonlocal status, content_type
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers[_HEADER] = request_id
                content_type = headers.get("content-type", "")
            elif status >= 400:
                self._errors.note(scope["method"], scope["path"], content_type, message.get("body", b""))
            await send({**message, "body": b""} if is_head and "body" in message else message)

        app = self._app
        if _num_head_bytes(scope) > _MOST_HEAD_BYTES:
            self._metrics.note_refusal("header-bytes")
            expected = f"expected at most {_MOST_HEAD_BYTES:,} bytes of path and headers, got more"
            detail = f"{expected}; send long values in the body"
            app = plain_problem_response(HTTP_PROBLEMS[431], detail, Request(scope))
        try:
            await app(inner, receive, send_with_id)
        except asyncio.CancelledError:
            # The time to drain is over.
            if status:
                raise
            stopped = NoWorkerError("the service was stopped before the answer; send the request again")
            await problem_response(stopped, request_id)(scope, receive, send_with_id)
        except Exception as error:
            _log.exception("a request failed unexpectedly")
            if status:
                raise
            await problem_response(error, request_id)(scope, receive, send_with_id)
        finally:
            route = getattr(inner.get("route"), "path", _UNMATCHED)
            self._note(scope, route, status, time.monotonic() - began)

    def _note(self, scope: Scope, route: str, status: int, duration_s: float) -> None:
        self._metrics.note_request(scope["method"], route, status, duration_s)
        quiet = route.startswith(("/health", "/metrics")) and status < 500
        _log.log(
            10 if quiet else 20,
            "request",
            method=scope["method"],
            route=route,
            path=scope["path"] if scope["path"].isprintable() else ascii(scope["path"]),
            status=status,
            duration_s=round(duration_s, 4),
        )


def _num_head_bytes(scope: Scope) -> int:
    path = len(scope.get("raw_path") or b"") + len(scope["query_string"])
    return path + sum(len(name) + len(value) for name, value in scope["headers"])
