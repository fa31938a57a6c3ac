"""Pages for people: the console, served without a key, and the description of the API; with nothing in them that others
could make run."""

import re
from pathlib import Path

import pytest

from panoloc.service.http.routes import pages
from panoloc.service.http.routes.pages import api_page
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder as the build leaves it."""
    folder = tmp_path / "built"
    (folder / "console").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html><script src=./console/index-1a2b.js></script>")
    (folder / "console" / "index-1a2b.js").write_text("void 0")
    (folder / "m").mkdir()
    (folder / "m" / "index.html").write_text("<!doctype html><script src=../console/phone-1a2b.js></script>")
    (folder / ".sources").write_text("0123")
    monkeypatch.setattr(pages, "BUILT", folder)
    return folder


@pytest.mark.parametrize(("path", "script"), [("/", "index-1a2b"), ("/m/map_any", "phone-1a2b")])
async def test_scripts_come_from_the_service_alone_and_no_page_frames_the_console(
    running: RunningService, built: Path, path: str, script: str
) -> None:
    reply = await running.client.get(path)
    assert (reply.status_code, reply.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert script in reply.text
    policy = dict(part.strip().split(" ", 1) for part in reply.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert reply.headers["x-content-type-options"] == "nosniff"
    assert reply.headers["referrer-policy"] == "no-referrer"
    assert reply.headers["cache-control"] == "no-cache"


async def test_browsers_that_look_for_an_icon_by_themselves_find_the_mark(
    running: RunningService, built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (built / "console" / "mark-3c4d.svg").write_text("<svg/>")
    found = await running.client.get("/favicon.ico")
    assert (found.status_code, found.text, found.headers["content-type"]) == (200, "<svg/>", "image/svg+xml")
    monkeypatch.setattr(pages, "BUILT", built / "none")
    assert await running.status("GET", "/favicon.ico") == 204


@pytest.mark.parametrize("name", ["none.js", "..%2Findex.html", "..%2F.sources", ".sources", "index-1a2b.js%00"])
async def test_nothing_else_of_the_folder_is_served(running: RunningService, built: Path, name: str) -> None:
    reply = await running.client.get(f"/console/{name}")
    assert (reply.status_code, reply.headers["content-type"]) == (404, "application/problem+json")


async def test_without_a_console_the_page_says_how_to_build_it(
    running: RunningService, built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "BUILT", built / "none")
    page = await running.client.get("/")
    assert page.status_code == 200
    assert "scripts/install" in page.text
    assert 'href="/docs"' in page.text
    assert await running.status("GET", "/maps") == 200


@pytest.mark.settings(api_keys="the-reader:read")
async def test_the_console_asks_for_no_key_and_browsers_keep_its_scripts(running: RunningService, built: Path) -> None:
    assert [await running.status("GET", path) for path in ("/", "/m/map_any")] == [200, 200]
    script = await running.client.get("/console/index-1a2b.js")
    assert (script.text, script.headers["content-type"]) == ("void 0", "text/javascript; charset=utf-8")
    assert "immutable" in script.headers["cache-control"]


async def test_every_request_is_described_without_anything_from_elsewhere(running: RunningService) -> None:
    document = await running.json("/openapi.json")
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
