"""A real browser on the console of a real service; WebGL is drawn in software."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.integration.running_service import eventually

CHROMIUM = "/usr/bin/chromium"
# Without the last, each page has its window load pages for an address bar that nobody sees: as much work as the page itself.
_ARGUMENTS = [
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-features=WebUIOmniboxPopup,WebUIOmniboxAimPopup,SpareRendererForSitePerProcess",
]
WAIT_MS = 120_000
# Whatever is expected may take as long: other tests run on the same processors.
expect.set_options(timeout=WAIT_MS)
# Null where the page does not have axe yet. Of what axe finds only this leaves the page: the rest is large.
_SERIOUS = """async () => {
    if (!window.axe) return null;
    const { violations } = await axe.run(document, { preload: false, resultTypes: ["violations"], selectors: false });
    const serious = violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
    return serious.flatMap(({ id, nodes }) => nodes.map(({ html }) => `${id}: ${html.slice(0, 200)}`));
}"""
AXE = Path(__file__).parents[2] / "service" / "console" / "node_modules" / "axe-core" / "axe.min.js"


@contextmanager
def browser(*arguments: str) -> Iterator[Browser]:
    """Start Debian's Chromium, as `scripts/install --dev` installs it."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=[*_ARGUMENTS, *arguments])
        yield chromium
        chromium.close()


@contextmanager
def page_of(chromium: Browser, url: str, **context: Any) -> Iterator[Page]:
    """Open a page; whatever it complains of, a refusal of its security policy included, fails the test."""
    complaints: list[str] = []
    with chromium.new_context(**{"viewport": {"width": 1100, "height": 720}, **context}) as opened:
        page = opened.new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda said: complaints.append(said.text) if _is_complaint(said.type, said.text) else None)
        page.goto(url)
        yield page
    assert complaints == []


def scene_state(page: Page) -> dict[str, Any]:
    """Return what the 3D view says of itself."""
    return dict(page.evaluate("document.querySelector('canvas[data-scene]').stage.state()"))


def wait_until_drawn(page: Page, num_points: int) -> None:
    """Wait until all points are there and the view has come to rest."""
    page.locator("canvas[data-scene]").wait_for()
    assert eventually(lambda: scene_state(page)["numPoints"] == num_points, WAIT_MS / 1000), scene_state(page)
    wait_until_still(page)


def picture_of(page: Page, folder: Path, name: str) -> NDArray[np.float32]:
    """Return the 3D view (H, W, 3) in 0..1 once it has come to rest."""
    wait_until_still(page)
    file = folder / f"{name}.png"
    page.locator("canvas[data-scene]").screenshot(path=file)
    return np.asarray(Image.open(file).convert("RGB"), np.float32) / np.float32(255)


def edges(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the strength of edges (H, W) of the upper part, without the controls, smoothed over the size of a point, mean 0, length 1."""
    grey = picture[: int(0.8 * len(picture))].mean(axis=2)
    for axis in (0, 1):
        grey = np.apply_along_axis(np.convolve, axis, grey, np.ones(15) / 15, "same")
    down, right = np.gradient(grey)
    strength = np.hypot(down, right)[20:-20, 20:-20]
    strength -= strength.mean()
    return np.asarray(strength / np.linalg.norm(strength), np.float32)


def best_shift(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[tuple[int, int], float]:
    """Return the shift in pixels (rows, columns) at which two edge pictures agree most, and the correlation there."""
    agreement = np.fft.irfft2(np.fft.rfft2(first) * np.conj(np.fft.rfft2(second)), first.shape)
    row, column = np.unravel_index(np.argmax(agreement), agreement.shape)
    height, width = agreement.shape
    return (
        (int(row) - height * (row > height // 2), int(column) - width * (column > width // 2)),
        float(agreement.max()),
    )


def serious_faults(page: Page) -> list[str]:
    """Return what axe finds that keeps people from reading or reaching something, as "rule: element".

    Style sheets are not fetched once more: a page in a folder may not.
    """
    found = page.evaluate(_SERIOUS)
    if found is None:
        page.evaluate(AXE.read_text(encoding="utf-8"))
        found = page.evaluate(_SERIOUS)
    return list(found)


def wait_until_still(page: Page) -> None:
    """Wait until the 3D view is at rest."""
    assert eventually(lambda: bool(scene_state(page)["isStill"]), WAIT_MS / 1000), scene_state(page)


def _is_complaint(kind: str, text: str) -> bool:
    # A failed request is said here too; tests of failures make some. So is what browsers leave out over http.
    return (
        kind == "error"
        and "Failed to load resource" not in text
        and "Opener-Policy header has been ignored" not in text
    )
