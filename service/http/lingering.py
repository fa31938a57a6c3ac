"""Lets callers read why an upload was refused although they have not sent all of it.

A server that closes while bytes still come in resets the connection, and many clients then never see the answer. So the
answer goes out at once, what still comes is thrown away for a moment, and then the connection is closed.
"""

import asyncio
import time

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_LONGEST_S = 2.0
_MOST_BYTES = 64 * 2**20


class LingeringClose:
    """ASGI middleware for answers that bear `Connection: close`."""

    def __init__(self, app: ASGIApp, longest_s: float = _LONGEST_S, most_bytes: int = _MOST_BYTES) -> None:
        self._app = app
        self._longest_s = longest_s
        self._most_bytes = most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        is_read = False
        closes = False

        async def noting_receive() -> Message:
            nonlocal is_read
            message = await receive()
            is_read = is_read or message["type"] == "http.disconnect" or not message.get("more_body", False)
            return message

        async def lingering_send(message: Message) -> None:
            nonlocal closes
            if message["type"] == "http.response.start":
                closes = Headers(raw=message["headers"]).get("connection", "") == "close"
            elif closes and not is_read and not message.get("more_body", False):
                await send({**message, "more_body": True})
                await self._throw_away(noting_receive)
                message = {"type": "http.response.body", "body": b"", "more_body": False}
            await send(message)

        await self._app(scope, noting_receive, lingering_send)

    async def _throw_away(self, receive: Receive) -> None:
        deadline, num_bytes = time.monotonic() + self._longest_s, 0
        while num_bytes < self._most_bytes:
            try:
                async with asyncio.timeout(deadline - time.monotonic()):
                    message = await receive()
            except TimeoutError:
                return
            num_bytes += len(message.get("body", b""))
            if message["type"] == "http.disconnect" or not message.get("more_body", False):
                return
