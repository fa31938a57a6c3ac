"""Ends bodies that come too slowly: a client that sends a byte now and then holds a place, and what it has sent so far."""

import asyncio
import time
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import SlowBodyError
from service.limits.connection_limits import Refusal


class SlowBodies:
    """ASGI middleware: reading a body raises SlowBodyError once it is `timeout_s` behind `bytes_per_s`."""

    def __init__(
        self, app: ASGIApp, timeout_s: float, bytes_per_s: float, note_refusal: Callable[[Refusal], None]
    ) -> None:
        self._app = app
        self._timeout_s = timeout_s
        self._bytes_per_s = bytes_per_s
        self._note_refusal = note_refusal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        waited_s, num_bytes, is_read = 0.0, 0, False

        async def timed_receive() -> Message:
            nonlocal waited_s, num_bytes, is_read
            if is_read:
                return await receive()
            # Only the time that was spent waiting counts: what the service does meanwhile is not the client's fault.
            began, allowed_s = time.monotonic(), self._timeout_s + num_bytes / self._bytes_per_s - waited_s
            try:
                async with asyncio.timeout(min(self._timeout_s, max(0.0, allowed_s))):
                    message = await receive()
            except TimeoutError as error:
                is_read = True
                self._note_refusal("slow-body")
                raise SlowBodyError(
                    f"expected a body of at least {self._bytes_per_s:g} bytes/s without pauses of {self._timeout_s:g} s "
                    f"(PANOLOC_MIN_BYTES_PER_S, PANOLOC_TRANSFER_TIMEOUT_S), got {num_bytes:,} bytes in {waited_s:.0f} s; send it again "
                    "over a better connection"
                ) from error
            waited_s += time.monotonic() - began
            num_bytes += len(message.get("body", b""))
            is_read = message["type"] == "http.disconnect" or not message.get("more_body", False)
            return message

        await self._app(scope, timed_receive, send)
