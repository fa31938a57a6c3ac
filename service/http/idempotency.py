"""`Idempotency-Key`: a request that is sent again, because its answer was lost on the way, is not done again."""

import base64
import re
from collections.abc import Awaitable, Callable
from hashlib import sha256
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from panoloc.service.cache import Cache
from panoloc.service.errors import CacheDownError, KeyReusedError, MalformedRequestError, RequestUnderWayError
from panoloc.service.http.access import caller_of
from panoloc.service.http.error_handlers import problem_response
from panoloc.service.http.openapi import IDEMPOTENT_PATHS

_KEY = re.compile(r"[\x21-\x7e]{1,255}")
_BOUNDARY = re.compile(r'boundary="?([^";,]+)"?', re.IGNORECASE)
_KEPT_HEADERS = ("content-type", "location", "content-location", "retry-after", "etag", "preference-applied")
_LARGEST_BYTES = 4 << 20


class Idempotency:
    """ASGI middleware: keeps the answers to POST requests with an `Idempotency-Key`, and sends them again for the same request."""

    def __init__(self, app: ASGIApp, cache: Cache, is_there: Callable[[str], Awaitable[bool]]) -> None:
        """is_there: tells of a path in `Location` or `Content-Location` whether it still leads to what was asked for."""
        self._app, self._cache, self._is_there = app, cache, is_there

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        headers = Headers(scope=scope) if scope["type"] == "http" else Headers()
        key = headers.get("idempotency-key")
        if key is None or scope["method"] != "POST" or scope["path"] not in IDEMPOTENT_PATHS:
            await self._app(scope, receive, send)
            return
        body = _Body(receive, headers, scope["query_string"])
        try:
            if not _KEY.fullmatch(key):
                raise MalformedRequestError("Idempotency-Key: expected 1 to 255 printable characters without spaces")
            caller = caller_of(Request(scope)).id
            name = sha256("\n".join((caller, scope["path"], key)).encode()).hexdigest()
            known = await self._cache.begin_once(name)
            if known is not None and await self._holds(known):
                await _replay(known, body, send)
                return
        except (MalformedRequestError, RequestUnderWayError, KeyReusedError, CacheDownError) as error:
            await problem_response(error, scope["state"]["request_id"])(scope, receive, send)
            return
        answer = _Recorded(send)
        try:
            await self._app(scope, body, answer)
        finally:
            # What may go better next time is done again.
            await self._cache.end_once(name, answer.document(body.digest) if answer.is_final else None)

    async def _holds(self, known: dict[str, Any]) -> bool:
        """Return whether an answer is still true: what it leads to may have failed, or be deleted."""
        headers = known.get("headers", {})
        location = headers.get("location", headers.get("content-location"))
        return location is None or await self._is_there(location)


class _Body:
    """Passes the body of a request on. digest: of what came, without the boundary between its parts, which is another each time."""

    def __init__(self, receive: Receive, headers: Headers, query: bytes) -> None:
        found = _BOUNDARY.search(headers.get("content-type", ""))
        self._boundary = b"--" + found[1].encode("latin-1") if found else None
        self._receive, self._left, self._is_whole = receive, b"", False
        self._hash = sha256(query + b"\n" + headers.get("prefer", "").strip().lower().encode("latin-1") + b"\n")

    async def __call__(self) -> Message:
        message = await self._receive()
        if message["type"] == "http.request":
            self._take(message.get("body", b""), is_last=not message.get("more_body", False))
        return message

    @property
    def digest(self) -> str:
        """Return it; of a body that has not come whole as well."""
        return self._hash.hexdigest()

    async def read(self) -> str:
        """Read the body to its end, and return the digest."""
        while not self._is_whole:
            if (await self())["type"] == "http.disconnect":
                break
        return self.digest

    def _take(self, data: bytes, is_last: bool) -> None:
        self._is_whole = self._is_whole or is_last
        if self._boundary is None:
            self._hash.update(data)
            return
        # The end may be the beginning of a boundary.
        text = (self._left + data).replace(self._boundary, b"")
        keep = 0 if is_last else min(len(text), len(self._boundary) - 1)
        self._left = text[len(text) - keep :]
        self._hash.update(text[: len(text) - keep])


class _Recorded:
    """Passes an answer on, and keeps it. is_final: whether the same request would be answered alike."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._status, self._headers, self._body = 0, dict[str, str](), bytearray()

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(raw=message["headers"])
            self._status = message["status"]
            self._headers = {name: headers[name] for name in _KEPT_HEADERS if name in headers}
        elif len(self._body) <= _LARGEST_BYTES:
            self._body += message.get("body", b"")
        await self._send(message)

    @property
    def is_final(self) -> bool:
        return 200 <= self._status < 300 and len(self._body) <= _LARGEST_BYTES

    def document(self, digest: str) -> dict[str, Any]:
        """Return the answer to a request of this digest as JSON."""
        body = base64.b64encode(self._body).decode("ascii")
        return {"digest": digest, "status": self._status, "headers": self._headers, "body": body}


async def _replay(known: dict[str, Any], request: _Body, send: Send) -> None:
    """Send an answer again. Raises KeyReusedError for a key of another request, RequestUnderWayError before there is an answer."""
    if "status" not in known:
        raise RequestUnderWayError(
            "the request with this Idempotency-Key is still being answered; ask again for its answer", 2
        )
    if known["digest"] != await request.read():
        raise KeyReusedError(
            "Idempotency-Key: expected the same request as before with this key, got another one; use a new key"
        )
    body = base64.b64decode(known["body"])
    headers = {**known["headers"], "idempotent-replayed": "true", "content-length": str(len(body))}
    raw = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": known["status"], "headers": raw})
    await send({"type": "http.response.body", "body": body})
