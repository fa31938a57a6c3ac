"""The console of a service that asks for keys: it asks in turn, and keeps the key for the tab alone."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from panoloc.service.host.embedded_redis import EmbeddedRedis
from tests.integration.console_page import browser, page_of
from tests.service.http.running_service import listening

pytestmark = [pytest.mark.integration, pytest.mark.slow]


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    # pytest's own folders are too long for a socket.
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        server = EmbeddedRedis(Path(folder))
        server.start()
        with listening(tmp_path, server.url, api_keys="the-reader:read") as served:
            yield served
        server.stop()


def test_the_console_asks_for_the_key_that_the_service_asks_for(url: str) -> None:
    with browser() as chromium, page_of(chromium, url) as page:
        expect(page.get_by_role("heading", name="This service asks for a key")).to_be_visible()
        assert page.get_by_role("heading", name="Maps").count() == 0
        page.get_by_label("Key", exact=True).fill("a-wrong-one")
        page.get_by_role("button", name="Use it").click()
        expect(page.get_by_role("alert")).to_contain_text("does not know the key")
        page.get_by_label("Key", exact=True).fill("the-reader")
        page.get_by_role("button", name="Use it").click()
        expect(page.get_by_role("heading", name="No maps yet")).to_be_visible()
        assert page.evaluate("Object.values(localStorage).includes('the-reader')") is False
        assert page.evaluate("Object.values(sessionStorage)") == ["the-reader"]
        assert page.context.cookies() == []
