"""The page that describes the API to people."""

import re

import pytest

from panoloc.service.http.api_page import api_page
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
    policy = reply.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")
    assert "script-src" not in policy
    assert re.findall(r'(?:src|href)="(?!#)([^"]*)"', reply.text) == ["openapi.json", "./"]
    links = set(re.findall(r'href="#(\w+)"', reply.text))
    assert "LocalizeOptions" in links
    assert links <= set(re.findall(r'id="(\w+)"', reply.text))


def test_what_descriptions_say_is_text() -> None:
    operation = {
        "summary": "<b>A</b>",
        "description": "<script>1</script>",
        "parameters": [{"name": "<i>", "in": "query", "required": True, "schema": {"type": "string"}}],
        "responses": {"200": {"description": "<img>", "content": {"application/json": {"example": "</pre><script>"}}}},
    }
    page = api_page({"info": {"title": "<t>", "version": "1"}, "paths": {"/<p>": {"get": operation}}})
    for tag in ("<b>", "<script", "<i>", "<img", "<t>", "<p>&lt;p"):
        assert tag not in page
    assert "&lt;script&gt;1&lt;/script&gt;" in page
