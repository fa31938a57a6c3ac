"""The page that describes the API to people: made from the OpenAPI document alone, without scripts and without anything
from elsewhere.

A script of another host on a page of this service could read the key that the console keeps for its tab.
"""

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from html import escape
from typing import Any

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
HEADERS = {
    "Content-Security-Policy": f"default-src 'none'; style-src 'sha256-{_STYLE_DIGEST}'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


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
