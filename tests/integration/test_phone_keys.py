"""Links with keys, and what is left of the page over http://, where phones give neither camera nor sensors."""

import json
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import FilePayload, expect

from tests.core.image.picture_files import encoded
from tests.integration.console_page import browser, page_of, serious_faults
from tests.integration.phone import SCREEN
from tests.service.http.running_service import SCAN, listening
from tests.service.started_redis import started_redis

pytestmark = [pytest.mark.integration, pytest.mark.slow]


def test_a_link_brings_its_key_and_over_http_photos_of_the_camera_app_are_taken(tmp_path: Path) -> None:
    with (
        started_redis() as server,
        listening(tmp_path, server.url, api_keys="the-owner") as url,
        httpx.Client(base_url=url, headers={"Authorization": "Bearer the-owner"}) as owner,
        browser("--host-resolver-rules=MAP scanner.test 127.0.0.1") as chromium,
    ):
        map_id = owner.post("/maps", files={"file": ("room.ply", SCAN)}).json()["id"]
        while owner.get(f"/maps/{map_id}").json()["status"] != "ready":
            time.sleep(0.05)
        service_url = url.replace("127.0.0.1", "scanner.test")
        link = owner.post(f"/maps/{map_id}/links", json={"service_url": service_url}).json()["url"]
        time.sleep(1.1)  # until the service looks at its keys again
        with page_of(chromium, link, viewport=SCREEN) as page:
            expect(page.get_by_text("The camera needs a secure address")).to_be_visible()
            assert page.get_by_role("button", name="Find where I am").count() == 0
            assert serious_faults(page) == []
            photo = FilePayload(name="photo.png", mimeType="image/png", buffer=encoded(np.zeros((4, 8, 3), np.uint8)))
            with page.expect_request("**/localize") as asked:
                page.get_by_label("Use the camera app").set_input_files(photo)
            assert asked.value.headers["authorization"] == f"Bearer {link.partition('#key=')[2]}"
            sent = asked.value.response()
            assert sent is not None
            assert json.loads(sent.text())["map_id"] == map_id
            expect(page.get_by_role("heading", name="You are here")).to_be_visible()
        with page_of(chromium, link.partition("#")[0], viewport=SCREEN) as page:
            expect(page.get_by_role("heading", name="This link has no key")).to_be_visible()
        with page_of(chromium, link[:-3], viewport=SCREEN) as page:
            expect(page.get_by_role("heading", name="The key of this link has ended")).to_be_visible()
