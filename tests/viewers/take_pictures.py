"""`python -m tests.viewers.take_pictures SCAN.ply PHOTO.jpg... --out PICTURE.jpg`: is a photo where its scan is, in viewers of others?

Places the photos, exports them, and lets Chromium show one from inside, in Photo Sphere Viewer and as Potree turns it, in bands that
alternate with the scan. Prints by how many pixels photo and scan of each viewer are apart, and keeps a picture of both. Needs npm, which
fetches the viewers that `package.json` names, and what `scripts/install --dev` installs.
"""

import argparse
import functools
import http.server
import io
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from core.exports.__main__ import write_folder
from core.exports.formats import export
from core.exports.tour import PlacedPhoto, Tour
from core.index.map_builder import build_map_index
from core.localizer import Localizer
from core.panorama.reader import read_panorama
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan

VIEWERS = ("photo-sphere-viewer", "potree")
_HERE = Path(__file__).parent
_SIZE = {"width": 1200, "height": 600}
_FURTHEST_PX, _STEP_PX = 24, 2
_KEPT_WIDTH, _QUALITY = 900, 75
_DRAWS_IN_SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


@dataclass(frozen=True)
class Meeting:
    """How a photo and its scan meet. shift_px: columns and rows by which the scan fits the photo best; correlation: there."""

    shift_px: tuple[int, int]
    correlation: float


def placed_tour(cloud: PointCloud, photos: Sequence[Path]) -> Tour:
    """Return the photos that are found in a scan, as a tour."""
    index, localizer, placed = build_map_index(cloud), Localizer(), []
    for path in photos:
        panorama = read_panorama(path.read_bytes())
        found = localizer.localize(panorama, [index])
        print(f"{path.name}: {found.status}", file=sys.stderr)
        if found.status == "localized" and found.best is not None:
            with Image.open(path) as image:
                placed.append(PlacedPhoto(path.name, found.best.pose, *image.size, image=path))
    return Tour("map", tuple(placed))


def write_site(folder: Path, cloud: PointCloud, tour: Tour) -> None:
    """Write the exports, the photos, the points and the pages into a folder, and fetch the viewers."""
    for name in ("psv", "potree"):
        write_folder(export(name, tour), folder / name)
    for photo in tour.photos:
        shutil.copy(photo.image or "", folder / photo.name)
    positions = (cloud.positions.astype(np.float64) + cloud.origin_offset).astype("<f4")
    (folder / "points.f32").write_bytes(positions.tobytes())
    (folder / "colors.u8").write_bytes(np.ascontiguousarray(cloud.colors).tobytes())
    for source in (*_HERE.glob("*.mjs"), _HERE / "page.html", _HERE / "package.json"):
        shutil.copy(source, folder)
    subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund"], cwd=folder, check=True)


@contextmanager
def pages(folder: Path) -> Iterator[tuple[Page, str]]:
    """Serve a folder on this machine alone, and give a page of Chromium and its address."""
    handler = functools.partial(_QuietHandler, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium"), headless=True, args=_DRAWS_IN_SOFTWARE
            )
            yield browser.new_page(viewport=_SIZE), f"http://127.0.0.1:{server.server_port}/page.html"  # type: ignore[arg-type]
            browser.close()
    finally:
        server.shutdown()
        server.server_close()


def picture_of(page: Page, address: str, viewer: str, shows: str, heading_deg: float) -> NDArray[np.uint8]:
    """Return (h, w, 3) what a viewer shows from inside the first photo. shows: "photo", "scan", or "both" in bands."""
    page.goto(f"{address}?viewer={viewer}&shows={shows}&heading={heading_deg}")
    page.wait_for_function("document.title === 'shown'", timeout=180_000)
    with Image.open(io.BytesIO(page.screenshot())) as image:
        return np.asarray(image.convert("RGB"))


def meeting_of(photo: NDArray[np.uint8], scan: NDArray[np.uint8]) -> Meeting:
    """Return by how much a scan has to be moved to fit a photo best, by the correlation of their grey values where there are points."""
    grey, points = photo.mean(axis=2), scan.mean(axis=2)
    inner = slice(_FURTHEST_PX, -_FURTHEST_PX)
    best = Meeting((0, 0), -1.0)
    for down in range(-_FURTHEST_PX, _FURTHEST_PX + 1, _STEP_PX):
        for right in range(-_FURTHEST_PX, _FURTHEST_PX + 1, _STEP_PX):
            moved = np.roll(points, (down, right), axis=(0, 1))[inner, inner]
            there = moved > 0
            found = float(np.corrcoef(grey[inner, inner][there], moved[there])[0, 1])
            if found > best.correlation:
                best = Meeting((right, down), found)
    return best


class _QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing of requests."""


def main(arguments: list[str]) -> int:
    """Take the pictures, and return 1 where photo and scan are apart."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scan", type=Path)
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--heading", type=float, default=0.0)
    given = parser.parse_args(arguments)
    cloud = read_scan(given.scan)
    tour = placed_tour(cloud, given.photos)
    shown, apart = [], False
    with tempfile.TemporaryDirectory(prefix="panoloc-viewers-") as name:
        write_site(Path(name), cloud, tour)
        with pages(Path(name)) as (page, address):
            for viewer in VIEWERS:
                seen = [picture_of(page, address, viewer, shows, given.heading) for shows in ("photo", "scan", "both")]
                meeting = meeting_of(seen[0], seen[1])
                apart = apart or max(map(abs, meeting.shift_px)) > _STEP_PX
                print(
                    f"{viewer}: photo and scan are {meeting.shift_px} px apart, correlation {meeting.correlation:.2f}"
                )
                shown.append(seen[2])
    small = Image.fromarray(np.vstack(shown)).resize((_KEPT_WIDTH, _KEPT_WIDTH * len(shown) // 2))
    small.save(given.out, "JPEG", quality=_QUALITY)
    return int(apart)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
