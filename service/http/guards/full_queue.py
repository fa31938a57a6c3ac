"""Refuses queries by their head while there is no place for them, so that a flood of them leaves the processors to the others.

What a query is refused with after its body was read costs milliseconds: parts, options, images, Redis. None of it is looked at here,
nor does the framework see the request; only who asks is checked first.
"""

from collections.abc import Sequence

from fastapi.routing import APIRoute
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.errors import QueueFullError
from service.http.access import caller_of
from service.http.guards.refusals import RefusalPace, refuse_by_head
from service.services import Services


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
        await refuse_by_head(error, scope, receive, send, self._pace)

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
