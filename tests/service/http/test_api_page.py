"""The page that describes the API to people."""

import re
from html.parser import HTMLParser

import pytest

from service.http.api_page import api_page
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio


async def test_every_request_is_described_without_anything_from_elsewhere(running: RunningService) -> None:
    document = (await running.client.get("/openapi.json")).json()
    reply = await running.client.get("/docs")
    assert (reply.status_code, reply.headers["content-type"]) == (200, "text/html; charset=utf-8")
    for path, item in document["paths"].items():
        for method in item:
            assert f'<span class="method">{method.upper()}</span><code>{path}</code>' in reply.text
    assert "<script" not in reply.text
    assert re.findall(r'(?:src|href)="(?!#)([^"]*)"', reply.text) == ["openapi.json", "./"]
    links = set(re.findall(r'href="#(\w+)"', reply.text))
    assert "LocalizeOptions" in links
    assert links <= set(re.findall(r'id="(\w+)"', reply.text))


async def test_browsers_run_and_fetch_nothing_on_it(running: RunningService) -> None:
    policy = (await running.client.get("/docs")).headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")
    assert "script-src" not in policy


class _Tags(HTMLParser):
    """Collects the names of the elements."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.add(tag)


def tags_of(page: str) -> set[str]:
    """Return the names of the page's elements."""
    parser = _Tags()
    parser.feed(page)
    return parser.found


PLAIN = {
    "summary": "A",
    "description": "1",
    "parameters": [{"name": "i", "in": "query", "required": True, "schema": {"type": "string"}}],
    "responses": {"200": {"description": "none", "content": {"application/json": {"example": "1"}}}},
}


def test_what_descriptions_say_is_text() -> None:
    operation = {
        "summary": "<b>A</b>",
        "description": "<script>1</script>",
        "parameters": [{"name": "<i>", "in": "query", "required": True, "schema": {"type": "string"}}],
        "responses": {"200": {"description": "<img>", "content": {"application/json": {"example": "</pre><script>"}}}},
    }
    page = api_page({"info": {"title": "<t>", "version": "1"}, "paths": {"/<p>": {"get": operation}}})
    assert tags_of(page) <= tags_of(api_page({"info": {"title": "t", "version": "1"}, "paths": {"/p": {"get": PLAIN}}}))
    assert "&lt;script&gt;1&lt;/script&gt;" in page
