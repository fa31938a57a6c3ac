"""Refuses requests by their head: of callers who ask too often, and queries for which the queue has no room.

What a query is refused with after its body was read costs milliseconds: parts, options, images, Redis. Refused by its
head it costs none of that, so that a flood leaves the processors to the others.
"""

import asyncio
import re
import time
from collections.abc import Sequence

from fastapi.routing import APIRoute
from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from panoloc.service.errors import QueueFullError, RateError, ServiceError
from panoloc.service.http.access import caller_of
from panoloc.service.http.error_handlers import problem_response
from panoloc.service.limits.caller_rates import CallerRates
from panoloc.service.services import Services

# Probes ask without a key, all of them from a few addresses; and so do browsers for the page that asks for a key.
_UNCOUNTED = re.compile(r"/(health(/.*)?|console/.*|favicon\.ico)?")
_WITH_UPLOADS = ("POST", "PUT")  # other methods bring a few words of JSON


class RefusalPace:
    """Spreads refusals over time: callers who ask again at once do so less often, and waiting takes no processor
    time."""

    def __init__(self, per_s: float = 200.0, longest_s: float = 0.025) -> None:
        """per_s: refusals that leave without delay, on average. longest_s: the longest delay."""
        self._interval_s = 1 / per_s
        self._longest_s = longest_s
        self._next = 0.0

    def hold_s(self, now: float) -> float:
        """Return the seconds to hold the next refusal back. now: monotonic seconds."""
        hold_s = min(self._longest_s, max(0.0, self._next - now))
        self._next = now + hold_s + self._interval_s
        return hold_s

    async def refuse(self, error: ServiceError, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request with an error."""
        if hold_s := self.hold_s(time.monotonic()):
            await asyncio.sleep(hold_s)
        await problem_response(error, scope["state"]["request_id"])(scope, receive, send)


class CallerRateCheck:
    """ASGI middleware: counts what each caller asks for, and refuses more than the operator allows."""

    def __init__(self, app: ASGIApp, rates: CallerRates) -> None:
        self._app = app
        self._rates = rates
        self._pace = RefusalPace()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or _UNCOUNTED.fullmatch(scope["path"]) or not self._rates.are_limited:
            await self._app(scope, receive, send)
            return
        caller, num_bytes = caller_of(Request(scope)).id, 0

        async def telling_send(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(raw=message["headers"]).update(await self._rates.headers(caller))
            await send(message)

        try:
            await self._rates.take(caller, scope["method"] in _WITH_UPLOADS)
        except RateError as error:
            await self._pace.refuse(error, scope, receive, telling_send)
            return

        async def counting_receive() -> Message:
            nonlocal num_bytes
            message = await receive()
            num_bytes += len(message.get("body", b""))
            return message

        try:
            await self._app(scope, counting_receive, telling_send)
        finally:
            # The bytes are known only now: the one request that goes beyond the limit is answered.
            await self._rates.spend(caller, num_bytes)


class QueueCheck:
    """ASGI middleware: refuses queries while the queue is full. routes: those that take queries, for callers with the
    scope `localize`."""

    def __init__(self, app: ASGIApp, services: Services, routes: Sequence[APIRoute]) -> None:
        self._app = app
        self._services = services
        self._routes = routes
        self._pace = RefusalPace()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        route = self._route_of(scope)
        error = None if route is None else self._why_not(scope)
        if route is None or error is None:
            await self._app(scope, receive, send)
            return
        scope["route"] = route  # for log and metrics
        self._services.metrics.note_refusal(error.limit)
        # The method is in the body.
        self._services.metrics.note_localization("unread", "queue-full", {})
        await self._pace.refuse(error, scope, receive, send)

    def _route_of(self, scope: Scope) -> APIRoute | None:
        if scope["type"] != "http" or scope["method"] != "POST":
            return None
        return next((route for route in self._routes if route.path_regex.match(scope["path"])), None)

    def _why_not(self, scope: Scope) -> QueueFullError | None:
        try:
            self._services.pool.require_place(self._services.settings.max_timeout_s)
        except QueueFullError as error:
            # The route tells all others which key they need.
            return error if "localize" in caller_of(Request(scope)).scopes else None
        return None
