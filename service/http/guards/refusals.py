"""Refusals of requests whose body nobody has read."""

import asyncio
import time

from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from service.errors import ServiceError
from service.http.error_handlers import problem_response

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


async def refuse_by_head(error: ServiceError, scope: Scope, receive: Receive, send: Send, pace: RefusalPace) -> None:
    """Answer a request with an error, as its head says: one with a large body, or of unknown length, is the last of its connection."""
    response = problem_response(error, scope["state"]["request_id"])
    if not _is_small(Headers(scope=scope)):
        response.headers["Connection"] = "close"
    if hold_s := pace.hold_s(time.monotonic()):
        await asyncio.sleep(hold_s)
    await response(scope, receive, send)


def _is_small(headers: Headers) -> bool:
    """Tell whether a body says that it is small; one of unknown length does not."""
    declared = headers.get("content-length", "")
    if "transfer-encoding" in headers:
        return False
    return not declared or (declared.isdigit() and int(declared) <= _MOST_UNREAD_BYTES)
