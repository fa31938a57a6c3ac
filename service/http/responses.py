"""How answers travel: not at all where the caller has them, and compressed where they are text."""

import re

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_LEAST_BYTES = 500  # fewer are hardly fewer when they are compressed
# Pictures and archives are compressed, and points take seconds for a fifth less.
_COMPRESSED_OR_LARGE = re.compile(r".*(\.(png|jpg|ply|zip|woff2)|/points|/export|/images/\d+)")
_NOT_OF_NOTHING = ("content-length", "content-type", "content-disposition")


class Compression:
    """ASGI middleware: sends text compressed to callers who accept that."""

    def __init__(self, app: ASGIApp) -> None:
        self._app, self._compressing = app, GZipMiddleware(app, minimum_size=_LEAST_BYTES, compresslevel=5)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        is_text = scope["type"] == "http" and not _COMPRESSED_OR_LARGE.fullmatch(scope["path"])
        await (self._compressing if is_text else self._app)(scope, receive, send)


class NotModified:
    """ASGI middleware: answers 304 where the caller has what the `ETag` of the answer names."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        known = Headers(scope=scope).get("if-none-match") if scope["type"] == "http" else None
        if known is None or scope["method"] not in ("GET", "HEAD"):
            await self._app(scope, receive, send)
            return
        is_known = False

        async def send_unless_known(message: Message) -> None:
            nonlocal is_known
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                is_known = message["status"] == 200 and _names(known, headers.get("etag"))
                if is_known:
                    message["status"] = 304
                    for name in _NOT_OF_NOTHING:
                        del headers[name]
            elif is_known:
                message = {**message, "body": b""}
            await send(message)

        await self._app(scope, receive, send_unless_known)


def _names(known: str, tag: str | None) -> bool:
    """Tell whether a caller names a tag among those that he knows; weak ones are as good."""
    tags = {each.strip().removeprefix("W/") for each in known.split(",")}
    return tag is not None and ("*" in tags or tag.removeprefix("W/") in tags)
