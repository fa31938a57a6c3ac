"""Refuses queries by their head while there is no place for them, so that a flood of them leaves the processors to the others.

What a query is refused with after its body was read costs milliseconds: parts, options, images, Redis. None of it is looked at here,
nor does the framework see the request; only who asks is checked first.
"""

import asyncio
import time
from collections.abc import Sequence

from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.errors import QueueFullError
from service.http.access import caller_of
from service.http.error_handlers import problem_response
from service.services import Services

# A connection whose next request waits behind so many bytes at most is kept: to throw them away costs less than a new connection.
_MOST_UNREAD_BYTES = 2**20


class RefusalPace:
    """Spreads refusals out: callers who ask again at once do so less often, and what waits takes no processor time."""

    def __init__(self, per_s: float = 200.0, longest_s: float = 0.025) -> None:
        """per_s: that leave at once, on average. longest_s: for which one is held back."""
        self._interval_s = 1 / per_s
        self._longest_s = longest_s
        self._next = 0.0

    def hold_s(self, now: float) -> float:
        """Return the seconds to hold the next refusal back. now: monotonic seconds."""
        hold_s = min(self._longest_s, max(0.0, self._next - now))
        self._next = now + hold_s + self._interval_s
        return hold_s


class FullQueue:
    """ASGI middleware. routes: that take queries, which nobody but callers with the scope `localize` may send."""

    def __init__(
        self, app: ASGIApp, services: Services, routes: Sequence[APIRoute], pace: RefusalPace | None = None
    ) -> None:
        self._app = app
        self._services = services
        self._routes = routes
        self._pace = pace or RefusalPace()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        route = self._route_of(scope)
        error = None if route is None else self._why_not(scope)
        if route is None or error is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = route  # for log and metrics
        self._services.metrics.note_refusal(error.limit)
        # The method stands in the body.
        self._services.metrics.note_localization("unread", "queue-full", {})
        response = problem_response(error, scope["state"]["request_id"])
        if not _is_small(Headers(scope=scope)):
            response.headers["Connection"] = "close"
        if hold_s := self._pace.hold_s(time.monotonic()):
            await asyncio.sleep(hold_s)
        await response(scope, receive, send)

    def _route_of(self, scope: Scope) -> APIRoute | None:
        if scope["type"] != "http" or scope["method"] != "POST":
            return None
        return next((route for route in self._routes if route.path_regex.match(scope["path"])), None)

    def _why_not(self, scope: Scope) -> QueueFullError | None:
        try:
            self._services.pool.require_place(self._services.settings.max_timeout_s)
        except QueueFullError as error:
            # All others are told who may ask, by the route.
            return error if "localize" in caller_of(Request(scope)).scopes else None
        return None


def _is_small(headers: Headers) -> bool:
    """Tell whether a body says that it is small; one of unknown length does not."""
    declared = headers.get("content-length", "")
    if "transfer-encoding" in headers:
        return False
    return not declared or (declared.isdigit() and int(declared) <= _MOST_UNREAD_BYTES)
