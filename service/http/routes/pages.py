"""Pages for people: the console and its page for phones, built from `service/console` by `scripts/install`, and the
description of the API.

The pages ask for no key: they fetch what they show with the key that their user enters, or that a link carries.
"""

import re
from pathlib import Path

from fastapi import Depends, Request
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response

from panoloc.service.http.access import require
from panoloc.service.http.api_page import HEADERS, api_page
from panoloc.service.http.openapi import Router

router = Router(include_in_schema=False)

BUILT = Path(__file__).parents[2] / "console" / "built"
_ASSET = re.compile(r"[\w-]+\.(?P<suffix>js|css|svg)")
_MEDIA_TYPES = {"js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_SECURITY = {
    # Only what the service itself sends runs or is shown; pictures and photos are shown from memory.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_NOT_BUILT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>panoloc</title>
<h1>panoloc</h1>
<p>The service runs, but its console is not built: run <code>scripts/install</code> in the
source folder, then reload this page.
The <a href="/docs">HTTP API</a> works.</p>
</html>
"""


@router.get("/")
async def console() -> Response:
    """Return the console, or say how to build it."""
    return _page("index.html")


@router.get("/m/{map_id}")
async def phone_page(map_id: str) -> Response:
    """Return the page on which a phone finds its place in a map; the page asks for the map."""
    return _page("m/index.html")


def _page(name: str) -> Response:
    index = BUILT / name
    headers = {**_SECURITY, "Cache-Control": "no-cache"}
    if not index.is_file():
        return HTMLResponse(_NOT_BUILT, headers=headers)
    return FileResponse(index, media_type="text/html", headers=headers)


@router.get("/favicon.ico")
async def icon() -> Response:
    """Return the icon where browsers look for it beside pictures and documents, which name none."""
    mark = next((BUILT / "console").glob("mark-*.svg"), None)
    headers = {**_SECURITY, "Cache-Control": "public, max-age=86400"}
    if mark is None:
        return Response(status_code=204, headers=headers)
    return FileResponse(mark, media_type=_MEDIA_TYPES["svg"], headers=headers)


@router.get("/console/{name}")
async def asset(name: str) -> Response:
    """Return a script, a style sheet or a picture of the console; a name changes with its content."""
    known = _ASSET.fullmatch(name)
    file = BUILT / "console" / name
    if known is None or not file.is_file():
        raise HTTPException(404)
    headers = {**_SECURITY, "Cache-Control": "public, max-age=31536000, immutable"}
    return FileResponse(file, media_type=_MEDIA_TYPES[known["suffix"]], headers=headers)


@router.get("/openapi.json", dependencies=[Depends(require("read"))])
async def openapi_document(request: Request) -> Response:
    """Return the OpenAPI document."""
    return JSONResponse(request.app.openapi())


@router.get("/docs", dependencies=[Depends(require("read"))])
async def documentation(request: Request) -> Response:
    """Show the OpenAPI document."""
    return HTMLResponse(api_page(request.app.openapi()), headers=HEADERS)
