"""Pages for people: the console and its page for phones, built from `service/console` by `scripts/install`, and the
description of the API, made from the OpenAPI document alone, without scripts and without anything from elsewhere.

The pages ask for no key: they fetch what they show with the key that their user enters, or that a link carries. A script of another host
on a page of this service could read the key that the console keeps for its tab.
"""

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from fastapi import Depends, Request
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response

from panoloc.service.http.access import require
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

_METHODS = ("get", "post", "put", "patch", "delete")
_REF = re.compile(r"&quot;\$ref&quot;: &quot;#/components/schemas/(\w+)&quot;")
_STYLE = """
:root { color-scheme: light dark; font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Noto Sans", sans-serif; }
body { max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h2 { margin: 2.5rem 0 .75rem; font-size: 1.15rem; }
details { border: 1px solid color-mix(in srgb, currentColor 20%, transparent); border-radius: 7px; margin: .4rem 0; padding: .5rem .75rem; }
summary { cursor: pointer; }
code, pre { font: .88em/1.45 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; }
pre { overflow-x: auto; padding: .6rem; border-radius: 6px; background: color-mix(in srgb, currentColor 7%, transparent); }
table { border-collapse: collapse; } td { padding: .15rem .9rem .15rem 0; vertical-align: top; }
.method { display: inline-block; min-width: 4.5rem; font-weight: 650; }
.soft { opacity: .75; }
"""
_STYLE_DIGEST = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
_API_PAGE_SECURITY = {
    "Content-Security-Policy": f"default-src 'none'; style-src 'sha256-{_STYLE_DIGEST}'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


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
    return HTMLResponse(api_page(request.app.openapi()), headers=_API_PAGE_SECURITY)


def api_page(document: dict[str, Any]) -> str:
    """Return the HTML of an OpenAPI document: what can be asked, with which parts, and what is answered."""
    info, schemas = document["info"], document.get("components", {}).get("schemas", {})
    operations = "".join(
        _operation(path, method, item[method])
        for path, item in document["paths"].items()
        for method in _METHODS
        if method in item
    )
    models = "".join(
        f'<details id="{escape(name)}"><summary><code>{escape(name)}</code></summary>{_json(schema)}</details>\n'
        for name, schema in sorted(schemas.items())
    )
    title = f"{info['title']} {info['version']}"
    return (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}: HTTP API</title>\n<style>{_STYLE}</style>\n<main>\n<h1>{escape(title)}</h1>\n"
        f"<p>{_text(info.get('description', ''))}</p>\n"
        '<p>For programs and API tools: <a href="openapi.json">openapi.json</a>. Try requests in the '
        '<a href="./">console</a>.</p>\n'
        f"<h2>Requests</h2>\n{operations}<h2>Schemas</h2>\n{models}</main>\n</html>\n"
    )


def _operation(path: str, method: str, operation: dict[str, Any]) -> str:
    parts = [f"<p>{_text(operation['description'])}</p>"] if operation.get("description") else []
    if operation.get("parameters"):
        parts.append(f"<h4>Parameters</h4><table>{''.join(map(_parameter, operation['parameters']))}</table>")
    if "requestBody" in operation:
        parts += ["<h4>Body</h4>", *_content(operation["requestBody"])]
    for status, response in operation["responses"].items():
        parts += [f"<h4>{escape(status)} <span class=soft>{_text(response.get('description', ''))}</span></h4>"]
        parts += _content(response)
    summary = escape(operation.get("summary", ""))
    return (
        f'<details><summary><span class="method">{method.upper()}</span><code>{escape(path)}</code> '
        f'<span class="soft">{summary}</span></summary>{"".join(parts)}</details>\n'
    )


def _parameter(parameter: dict[str, Any]) -> str:
    needed = ", required" if parameter.get("required") else ""
    schema = escape(json.dumps(parameter.get("schema", {})))
    return (
        f"<tr><td><code>{escape(parameter['name'])}</code></td><td class=soft>{escape(parameter['in'])}{needed}</td>"
        f"<td>{_text(parameter.get('description', ''))} <code>{schema}</code></td></tr>"
    )


def _content(owner: dict[str, Any]) -> Iterator[str]:
    for media, content in owner.get("content", {}).items():
        yield f"<p><code>{escape(media)}</code></p>{_json({k: v for k, v in content.items() if k != 'encoding'})}"


def _text(text: str) -> str:
    """Return text with what stands between backquotes as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def _json(value: Any) -> str:
    text = escape(json.dumps(value, indent=2, ensure_ascii=False))
    linked = _REF.sub(r'&quot;$ref&quot;: <a href="#\1">\1</a>', text)
    return f"<pre>{linked}</pre>"
