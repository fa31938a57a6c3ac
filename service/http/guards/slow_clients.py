"""Ends bodies that come too slowly and answers that are read too slowly, and lets refused clients read why.

A server that closes while bytes still arrive resets the connection, and many clients never see the answer. So an answer
that is ready early leaves at once, and the connection closes only after the rest was discarded for a moment.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from panoloc.service.errors import SlowBodyError
from panoloc.service.limits.capacity import Refusal

TIMEOUT_S = 30.0  # that a transfer may lag behind the pace
BYTES_PER_S = 1024.0
# The connection is kept when no more than this is unread: discarding it costs less than a new connection.
_MOST_UNREAD_BYTES = 2**20
_LINGER_S, _MOST_LINGER_BYTES = 2.0, 64 * 2**20
_PIECE_BYTES = 64 * 1024  # as many as uvicorn buffers: a client that is cut off leaves no more than two of them

_T = TypeVar("_T")


class SlowClients:
    """ASGI middleware. note_refusal: called with the limit that a client has hit."""

    def __init__(self, app: ASGIApp, note_refusal: Callable[[Refusal], None]) -> None:
        self._app, self._note_refusal = app, note_refusal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request; reading a body that comes too slowly raises SlowBodyError."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        exchange = _Exchange(Headers(scope=scope), receive, send, self._note_refusal)
        await self._app(scope, exchange.receive, exchange.send)
        await exchange.finish()


class _Pace:
    """Measures the seconds spent waiting in one direction; time that the service takes does not count."""

    num_bytes, waited_s = 0, 0.0

    async def wait(self, transfer: Awaitable[_T]) -> _T:
        """Wait for a transfer. Raises TimeoutError where it lags too far behind."""
        began, left_s = time.monotonic(), TIMEOUT_S + self.num_bytes / BYTES_PER_S - self.waited_s
        async with asyncio.timeout(min(TIMEOUT_S, max(0.0, left_s))):
            done = await transfer
        self.waited_s += time.monotonic() - began
        return done


class _Exchange:
    """One request and its answer."""

    def __init__(self, headers: Headers, receive: Receive, send: Send, note_refusal: Callable[[Refusal], None]) -> None:
        self._receive, self._send, self._note_refusal = receive, send, note_refusal
        self._received, self._sent = _Pace(), _Pace()
        declared = "" if "transfer-encoding" in headers else headers.get("content-length", "0")
        self._is_read = declared == "0"
        self._closes = not declared.isdecimal() or int(declared) > _MOST_UNREAD_BYTES
        self._is_gone = False

    async def receive(self) -> Message:
        """Return the next part of the request. Raises SlowBodyError."""
        try:
            return await (self._next() if self._is_read else self._received.wait(self._next()))
        except TimeoutError as error:
            self._closes = True
            self._note_refusal("slow-body")
            raise SlowBodyError(
                f"expected a body of at least {BYTES_PER_S:g} bytes/s without pauses of {TIMEOUT_S:g} s, got "
                f"{self._received.num_bytes:,} bytes in {self._received.waited_s:.0f} s; send it again over a faster "
                "connection"
            ) from error

    async def send(self, message: Message) -> None:
        """Send a part of the answer; its end is left to `finish`."""
        if message["type"] == "http.response.start":
            self._closes = self._closes and not self._is_read
            if self._closes:
                MutableHeaders(scope=message)["Connection"] = "close"
            await self._write(message)
            return
        body = message.get("body", b"")
        for at in range(0, len(body), _PIECE_BYTES):
            await self._write({**message, "body": body[at : at + _PIECE_BYTES], "more_body": True})

    async def _next(self) -> Message:
        message = await self._receive()
        self._received.num_bytes += len(message.get("body", b""))
        self._is_read = self._is_read or not message.get("more_body", False)
        return message

    async def _write(self, message: Message) -> None:
        if self._is_gone:
            return
        try:
            await self._sent.wait(self._send(message))
        except TimeoutError:
            # uvicorn closes the connection of an answer that does not end.
            self._is_gone = True
            self._note_refusal("slow-reader")
        self._sent.num_bytes += len(message.get("body", b""))

    async def finish(self) -> None:
        """End the answer, once the rest of the request was discarded."""
        most = self._received.num_bytes + _MOST_LINGER_BYTES
        try:
            async with asyncio.timeout(_LINGER_S if self._closes else TIMEOUT_S):
                while not self._is_read and self._received.num_bytes < most:
                    await self._next()
        except TimeoutError:
            self._is_gone = not self._closes
        await self._write({"type": "http.response.body", "body": b"", "more_body": False})
