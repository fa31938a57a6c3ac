"""The screenshots of the documentation: six views of the console at three widths, of the demo room, in Debian's Chromium.

scripts/screenshots [FOLDER]    writes docs/console/*.webp unless another folder is given
"""

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from panoloc.lab.background_service import OwnService, own_service
from panoloc.lab.demo_room import CHANGED_FRACTION, SEED, demo_scene
from panoloc.lab.rooms import change_scene, sample_pose, take_panorama

_SIZES = ((1440, 900), (900, 1180), (390, 844))
_NUM_PHOTOS = 5
_TIMEOUT_MS = 300_000
# WebGL in software, where there is no GPU.
_ARGUMENTS = ["--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
_IS_STILL = """() => {
    const state = document.querySelector('canvas[data-scene]')?.stage?.state();
    return !document.querySelector('canvas[data-scene]') || (state?.isStill && state.numPoints > 0);
}"""


def take_screenshots(folder: Path) -> None:
    """Write all screenshots."""
    folder.mkdir(parents=True, exist_ok=True)
    with own_service() as service:
        photos = _make_photos(service.folder)
        with _page() as page:
            map_page, batch_page = _prepare(page, service, photos)
        for width, height in _SIZES:
            with _page(viewport={"width": width, "height": height}, color_scheme="light") as page:
                for name in _views(page, service, photos, map_page, batch_page):
                    page.wait_for_function(_IS_STILL)
                    page.wait_for_timeout(1500)
                    shot = Image.open(io.BytesIO(page.screenshot()))
                    shot.convert("RGB").save(folder / f"{name}-{width}.webp", quality=74, method=6)


@contextmanager
def _page(**context: Any) -> Iterator[Page]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=_ARGUMENTS)
        page = browser.new_context(**context).new_page()
        page.set_default_timeout(_TIMEOUT_MS)
        yield page
        browser.close()


def _make_photos(folder: Path) -> list[Path]:
    """Take panoramas of the changed demo room, and add a file that is not an image."""
    changed = change_scene(demo_scene(), CHANGED_FRACTION, seed=SEED)
    rng = np.random.default_rng(SEED)
    files = [folder / f"round-{number:02}.jpg" for number in range(1, _NUM_PHOTOS + 1)]
    for file in files:
        picture = take_panorama(changed, sample_pose(changed, rng, "tilted"), 1024).color
        Image.fromarray(picture).save(file, quality=92)
    (folder / "floor-plan.pdf").write_bytes(b"%PDF-1.7")
    return [*files, folder / "floor-plan.pdf"]


def _prepare(page: Page, service: OwnService, photos: list[Path]) -> tuple[str, str]:
    """Register the demo room and send the photos as a batch; return the addresses of both pages."""
    page.goto(service.url)
    page.get_by_role("button", name="Try the demo room").click()
    expect(page.get_by_label("Answer", exact=True)).to_be_visible(timeout=_TIMEOUT_MS)
    map_page = page.url.partition("/answers/")[0]
    page.goto(f"{service.url}/#/localize")
    page.get_by_role("checkbox", name="Keep as a batch").check()
    page.get_by_label("Choose photos to localize").set_input_files(photos)
    expect(page.get_by_text(f"{_NUM_PHOTOS} placed")).to_be_visible(timeout=_TIMEOUT_MS)
    return map_page, page.url


def _views(page: Page, service: OwnService, photos: list[Path], map_page: str, batch_page: str) -> Iterator[str]:
    """Show one view after the other, and yield the name of each."""
    page.goto(map_page)
    page.get_by_label("Choose photos to localize").set_input_files(photos[:3])
    expect(page.get_by_label("Photos and their answers").get_by_role("img")).to_have_count(3, timeout=_TIMEOUT_MS)
    yield "answer"
    if page.get_by_role("button", name="Stand here").count():
        page.get_by_role("button", name="Stand here").click()
        page.get_by_label("From points to photo").fill("0.55")
    yield "stand"
    page.goto(batch_page)
    expect(page.get_by_role("heading", name="Not placed")).to_be_visible(timeout=_TIMEOUT_MS)
    yield "batch"
    page.goto(map_page)
    page.get_by_role("button", name="Changes").click()
    expect(page.get_by_label("Answers that count, newest first")).to_be_visible(timeout=_TIMEOUT_MS)
    yield "changes"
    page.goto(f"{service.url}/#/operations")
    expect(page.get_by_role("list", name="State")).to_be_visible()
    yield "operations"
    page.goto(f"{service.url}/#/maps")
    expect(page.get_by_role("list", name="Maps", exact=True).get_by_role("img")).to_have_count(1)
    yield "maps"


if __name__ == "__main__":
    take_screenshots(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "console")
