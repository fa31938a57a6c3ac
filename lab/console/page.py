"""A page of the console in Debian's Chromium, without a window; WebGL is drawn in software where there is no GPU."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Page, sync_playwright

CHROMIUM = "/usr/bin/chromium"
_ARGUMENTS = ["--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
_PATIENCE_S = 300.0


@contextmanager
def open_page(**context: Any) -> Iterator[Page]:
    """Open an empty page. context: as of Playwright's `new_context`, such as `viewport` and `color_scheme`."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS)
        page = browser.new_context(**context).new_page()
        page.set_default_timeout(1000 * _PATIENCE_S)
        yield page
        browser.close()


def scene_state(page: Page) -> dict[str, Any]:
    """Return what the 3D view says of itself; empty without one."""
    found = page.evaluate("document.querySelector('canvas[data-scene]')?.stage?.state() ?? {}")
    return dict(found)


def wait_until_still(page: Page) -> None:
    """Wait until all points are there and drawn, where the page has a 3D view. Raises TimeoutError."""
    give_up = time.monotonic() + _PATIENCE_S
    while page.locator("canvas[data-scene]").count():
        state = scene_state(page)
        if state.get("isStill") and state["numPoints"]:
            return
        if time.monotonic() > give_up:
            raise TimeoutError(f"the 3D view did not come to rest: {state}")
        time.sleep(0.2)
