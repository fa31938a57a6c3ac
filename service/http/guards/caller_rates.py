"""Counts what each caller asks for, and refuses more than he may, before anything is read of it."""

import re

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import RateError
from service.http.access import caller_of
from service.http.guards.refusals import RefusalPace, refuse_by_head
from service.limits.caller_rates import CallerRates

# Probes ask without a key, all of them from a few addresses; and so do browsers for the page that asks for a key.
_UNCOUNTED = re.compile(r"/(health(/.*)?|console/.*|favicon\.ico)?")
_WITH_UPLOADS = ("POST", "PUT")  # what others bring is a few words of JSON


class CountedCallers:
    """ASGI middleware."""

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
        try:
            await self._rates.take(caller, scope["method"] in _WITH_UPLOADS)
        except RateError as error:
            await refuse_by_head(error, scope, receive, send, self._pace)
            return

        async def counting_receive() -> Message:
            nonlocal num_bytes
            message = await receive()
            num_bytes += len(message.get("body", b""))
            return message

        try:
            await self._app(scope, counting_receive, send)
        finally:
            # What was sent is known afterwards: the one request that goes beyond the limit is answered.
            await self._rates.spend(caller, num_bytes)
