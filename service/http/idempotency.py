"""`Idempotency-Key`: a request that is sent again, because its answer was lost on the way, is not done again."""

import base64
import json
import re
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
_KEPT_HEADERS = ("content-type", "location", "retry-after", "etag", "preference-applied")
_LARGEST_BYTES = 4 << 20


class Idempotency:
    """ASGI middleware: keeps the answers to POST requests with an `Idempotency-Key`, and sends them again for the same key."""

    def __init__(self, app: ASGIApp, cache: Cache) -> None:
        self._app, self._cache = app, cache

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        headers = Headers(scope=scope) if scope["type"] == "http" else Headers()
        key = headers.get("idempotency-key")
        if key is None or scope["method"] != "POST" or scope["path"] not in IDEMPOTENT_PATHS:
            await self._app(scope, receive, send)
            return
        try:
            if not _KEY.fullmatch(key):
                raise MalformedRequestError("Idempotency-Key: expected 1 to 255 printable characters without spaces")
            caller, length = caller_of(Request(scope)).id, headers.get("content-length", "")
            name = sha256("\n".join((caller, scope["path"], key)).encode()).hexdigest()
            known = await self._cache.begin_once(name, length)
            if known is not None:
                await _replay(known, length, send)
                return
        except (MalformedRequestError, RequestUnderWayError, KeyReusedError, CacheDownError) as error:
            await problem_response(error, scope["state"]["request_id"])(scope, receive, send)
            return
        answer = _Recorded(send)
        try:
            await self._app(scope, receive, answer)
        finally:
            # What may go better next time is done again.
            document = answer.document(length) if answer.is_final else None
            await self._cache.end_once(name, document)


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

    def document(self, length: str) -> dict[str, Any]:
        """Return the answer to a request of so many bytes as JSON."""
        body = base64.b64encode(self._body).decode("ascii")
        return {"length": length, "status": self._status, "headers": self._headers, "body": body}


async def _replay(known: bytes, length: str, send: Send) -> None:
    """Send an answer again. Raises KeyReusedError for a key of another request, RequestUnderWayError before there is an answer."""
    found = json.loads(known)
    if found["length"] != length:
        raise KeyReusedError(
            "Idempotency-Key: expected the same request as before with this key, got another one; use a new key"
        )
    if "status" not in found:
        raise RequestUnderWayError(
            "the request with this Idempotency-Key is still being answered; ask again for its answer", 2
        )
    body = base64.b64decode(found["body"])
    headers = {**found["headers"], "idempotent-replayed": "true", "content-length": str(len(body))}
    raw = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": found["status"], "headers": raw})
    await send({"type": "http.response.body", "body": body})
