"""The screenshots of the documentation: six views of the console at three widths, of the demo room.

scripts/screenshots [FOLDER]    writes docs/console/*.webp unless another folder is given
"""

import io
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, expect

from lab.console.page import open_page, wait_until_still
from lab.demo_room import CHANGED_FRACTION, ROOM_AREA_M2, ROOM_FAMILY, SEED
from lab.own_service import OwnService, own_service
from lab.rooms import SceneSpec, build_scene, change_scene, sample_pose, take_panorama

SIZES = ((1440, 900), (900, 1180), (390, 844))
NUM_PHOTOS = 5
_PANORAMA_WIDTH = 1024
_QUALITY = 74
_PATIENCE_MS = 300_000


def make_photos(folder: Path) -> list[Path]:
    """Take panoramas all over the changed demo room, and put a file among them that is none."""
    room = build_scene(SceneSpec(kind="room", seed=SEED, family=ROOM_FAMILY, area_m2=ROOM_AREA_M2))
    changed = change_scene(room, CHANGED_FRACTION, seed=SEED)
    rng = np.random.default_rng(SEED)
    files = []
    for number in range(1, NUM_PHOTOS + 1):
        picture = take_panorama(changed, sample_pose(changed, rng, "tilted"), _PANORAMA_WIDTH).color
        files.append(folder / f"round-{number:02}.jpg")
        Image.fromarray(picture).save(files[-1], quality=92)
    (folder / "floor-plan.pdf").write_bytes(b"%PDF-1.7")
    return [*files, folder / "floor-plan.pdf"]


def prepare(page: Page, service: OwnService, photos: list[Path]) -> tuple[str, str]:
    """Register the demo room and send the photos as a batch; return the addresses of both pages."""
    page.goto(service.url)
    page.get_by_role("button", name="Try the demo room").click()
    expect(page.get_by_label("Answer", exact=True)).to_be_visible(timeout=_PATIENCE_MS)
    map_page = page.url.partition("/answers/")[0]
    page.goto(f"{service.url}/#/localize")
    page.get_by_role("checkbox", name="Keep as a batch").check()
    page.get_by_label("Choose photos to localize").set_input_files(photos)
    expect(page.get_by_text(f"{NUM_PHOTOS} placed")).to_be_visible(timeout=_PATIENCE_MS)
    return map_page, page.url


def views(page: Page, service: OwnService, photos: list[Path], map_page: str, batch_page: str) -> Iterator[str]:
    """Bring the page to one view after the other, and yield the name of each."""
    page.goto(map_page)
    page.get_by_label("Choose photos to localize").set_input_files(photos[:3])
    expect(page.get_by_label("Photos and their answers").get_by_role("img")).to_have_count(3, timeout=_PATIENCE_MS)
    yield "answer"
    if page.get_by_role("button", name="Stand here").count():
        page.get_by_role("button", name="Stand here").click()
        page.get_by_label("From points to photo").fill("0.55")
    yield "stand"
    page.goto(batch_page)
    expect(page.get_by_text("Without a place")).to_be_visible(timeout=_PATIENCE_MS)
    yield "batch"
    page.goto(map_page)
    page.get_by_role("button", name="Changes").click()
    expect(page.get_by_label("Answers that count, newest first")).to_be_visible(timeout=_PATIENCE_MS)
    yield "changes"
    page.goto(f"{service.url}/#/operations")
    expect(page.get_by_role("list", name="State")).to_be_visible()
    yield "operations"
    page.goto(f"{service.url}/#/maps")
    expect(page.get_by_role("list", name="Maps", exact=True).get_by_role("img")).to_have_count(1)
    yield "maps"


def take_screenshots(folder: Path) -> None:
    """Write all screenshots."""
    folder.mkdir(parents=True, exist_ok=True)
    with own_service() as service:
        photos = make_photos(service.folder)
        with open_page() as page:
            map_page, batch_page = prepare(page, service, photos)
        for width, height in SIZES:
            with open_page(viewport={"width": width, "height": height}, color_scheme="light") as page:
                for name in views(page, service, photos, map_page, batch_page):
                    wait_until_still(page)
                    page.wait_for_timeout(1500)
                    shot = Image.open(io.BytesIO(page.screenshot()))
                    shot.convert("RGB").save(folder / f"{name}-{width}.webp", quality=_QUALITY, method=6)
                    print(f"{name}-{width}", flush=True)


if __name__ == "__main__":
    take_screenshots(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "docs" / "console")
