"""The console of a service that asks for keys: it asks in turn, and keeps the key for the tab alone."""

from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.integration.console_page import browser, page_of
from tests.service.http.running_service import listening
from tests.service.started_redis import started_redis

pytestmark = [pytest.mark.integration, pytest.mark.slow]


def test_the_console_asks_for_the_key_that_the_service_asks_for(tmp_path: Path) -> None:
    with (
        started_redis() as server,
        listening(tmp_path, server.url, api_keys="the-reader:read") as url,
        browser() as chromium,
        page_of(chromium, url) as page,
    ):
        expect(page.get_by_role("heading", name="This service asks for a key")).to_be_visible()
        assert page.get_by_role("heading", name="Maps").count() == 0
        page.get_by_label("Key", exact=True).fill("a-wrong-one")
        page.get_by_role("button", name="Use it").click()
        expect(page.get_by_role("alert")).to_contain_text("does not know the key")
        page.get_by_label("Key", exact=True).fill("the-reader")
        page.get_by_role("button", name="Use it").click()
        expect(page.get_by_role("heading", name="No maps yet")).to_be_visible()
        assert page.evaluate("Object.values(localStorage).includes('the-reader')") is False
        assert page.evaluate("Object.values(sessionStorage).includes('the-reader')") is True
        assert page.context.cookies() == []
