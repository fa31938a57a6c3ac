"""Photo Sphere Viewer and Pannellum themselves, in a browser, show what lies in a direction of the map when they look there.

The panoramas are painted with directions: a colour says where its pixel lies in the map.
"""

import base64
import io
import json
import mimetypes
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, Route

from panoloc.core.exports.exif_gps import GpsPosition
from panoloc.core.exports.gpano import with_fields
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.exports.web_pages import DIGESTS
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ExportFormat
from tests.core.exports.tours import LARGE, directions, rotation_of, written
from tests.integration.console_page import browser

pytestmark = [pytest.mark.slow, pytest.mark.integration]

MODULES = Path(__file__).parents[2] / "web_viewers" / "node_modules"
LIMIT_DEG = 0.7
TURNS = [(37.5, -12.25, 4.75), (200, 62, -35), (301, -80, 10), (120, 15, 170)]
GPANO = {
    "ProjectionType": "equirectangular",
    **dict.fromkeys(("FullPanoWidthPixels", "CroppedAreaImageWidthPixels"), "1024"),
    **dict.fromkeys(("FullPanoHeightPixels", "CroppedAreaImageHeightPixels"), "512"),
    **dict.fromkeys(("CroppedAreaLeftPixels", "CroppedAreaTopPixels"), "0"),
    "PoseHeadingDegrees": "107.25",
    "PosePitchDegrees": "-8.5",
    "PoseRollDegrees": "3.25",
    "InitialViewHeadingDegrees": "40",
    "InitialViewPitchDegrees": "5",
}


def painted(rotation: np.ndarray) -> bytes:
    row, column = np.mgrid[0:512, 0:1024] + 0.5
    azimuth, elevation = np.pi - 2 * np.pi * column / 1024, np.pi / 2 - np.pi * row / 512
    seen = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    out = io.BytesIO()
    Image.fromarray(np.rint(127.5 + 127.5 * seen @ rotation.T).astype(np.uint8)).save(
        out, "JPEG", quality=100, subsampling=0
    )
    return out.getvalue()


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Tour:
    """Return photos of a national grid, turned every way; all but the first say in GPano how they are turned, and are wrong."""
    folder, photos = tmp_path_factory.mktemp("photos"), []
    for number, turns in enumerate(TURNS):
        rotation, name = rotation_of(*turns), f"hall #{number} <b>50%.jpg"
        plain = painted(rotation)
        (folder / str(number)).write_bytes(with_fields(plain, GPANO, GpsPosition(0, 0, None, 0)) if number else plain)
        position = LARGE + np.array([2.0 * number, (number % 2) * 1.5, 0.1 * number])
        photos.append(PlacedPhoto(name, Pose(rotation, position), 1024, 512, image=folder / str(number)))
    return Tour("map_1", tuple(photos), coordinate_system="EPSG:25832")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@contextmanager
def opened(chromium: Browser, name: ExportFormat, tour: Tour, folder: Path) -> Iterator[Page]:
    """Open the page of an export; the mirror of npm is the packages that the tests have, and nothing else answers."""
    files = written(name, tour, folder)
    complaints: list[str] = []

    def answer(route: Route) -> None:
        url = urlparse(route.request.url)
        path = unquote(url.path).lstrip("/") or "index.html"
        file = (
            files / path
            if url.hostname == "tour.test"
            else MODULES / re.sub(r"(?<=\w)@[\d.]+", "", path.removeprefix("npm/"))
        )
        if url.hostname not in ("tour.test", "cdn.jsdelivr.net") or not file.is_file():
            complaints.append(route.request.url)
            return route.abort()
        kind = mimetypes.guess_type(file.name)[0] or "text/plain"
        return route.fulfill(path=file, content_type=kind, headers={"Access-Control-Allow-Origin": "*"})

    with chromium.new_context(viewport={"width": 240, "height": 180}) as context:
        context.route("**/*", answer)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda said: complaints.append(said.text) if "nknown option" in said.text else None)
        page.goto("http://tour.test/")
        yield page
    assert [said for said in complaints if "favicon" not in said] == []


def has_all_photos(page: Page, tour: Tour) -> bool:
    page.locator("#photos").wait_for()
    return page.locator("#photos option").all_inner_texts() == [photo.name for photo in tour.photos]


def expected_and_links(tour: Tour, number: int, linked: list[int]) -> np.ndarray:
    """Return (24 + n, 3): known directions, and those to the photos that are linked."""
    positions = np.array([photo.map_from_camera.position for photo in tour.photos])
    towards = positions[linked] - positions[number]
    return np.vstack([directions(number), towards / np.linalg.norm(towards, axis=1, keepdims=True)])


def worst_deg(colors: Any, wanted: np.ndarray) -> float:
    found = np.array(colors).reshape(len(wanted), -1, 4).mean(axis=1)[:, :3] / 127.5 - 1
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip((found * wanted).sum(axis=1), -1, 1))).max())


def headings_of(wanted: np.ndarray) -> list[list[float]]:
    """Return heading from the map's y axis and elevation, in degrees."""
    x, y, z = wanted.T
    return np.degrees(np.stack([np.arctan2(x, y), np.arcsin(np.clip(z, -1, 1))], axis=1)).tolist()  # type: ignore[no-any-return]


LOOK_WITH_PSV = """async ([id, views]) => {
  const plugin = viewer.getPlugin("virtual-tour");
  await plugin.setCurrentNode(id, { effect: "none", rotation: false, showLoader: false });
  const gl = viewer.container.querySelector("canvas").getContext("webgl2");
  const colors = [];
  for (const [yaw, pitch] of views) {
    viewer.rotate({ yaw, pitch });
    viewer.needsUpdate();
    await new Promise((resolve) => viewer.addEventListener("render", resolve, { once: true }));
    const middle = new Uint8Array(16 * 16 * 4);
    gl.readPixels(gl.drawingBufferWidth / 2 - 8, gl.drawingBufferHeight / 2 - 8, 16, 16, gl.RGBA, gl.UNSIGNED_BYTE, middle);
    colors.push([...middle]);
  }
  return colors;
}"""


def test_photo_sphere_viewer_shows_directions_and_links_where_they_are(
    chromium: Browser, tour: Tour, tmp_path: Path
) -> None:
    with opened(chromium, "psv", tour, tmp_path) as page:
        assert has_all_photos(page, tour)
        # Asked again for the photo that it still loads, the viewer drops both requests and never draws.
        page.wait_for_function("viewer.getPlugin('virtual-tour').getCurrentNode()")
        nodes = json.loads((tmp_path / "tour.json").read_text())["virtualTour"]["nodes"]
        for number, node in enumerate(nodes):
            linked = [int(link["nodeId"]) for link in node["links"]]
            wanted = expected_and_links(tour, number, linked)
            views: list[list[Any]] = [[f"{value}deg" for value in view] for view in headings_of(wanted[:24])]
            views += [[link["position"]["yaw"], link["position"]["pitch"]] for link in node["links"]]
            assert worst_deg(page.evaluate(LOOK_WITH_PSV, [node["id"], views]), wanted) < LIMIT_DEG, node["data"][
                "name"
            ]


LOOK_WITH_PANNELLUM = """async ([scene, views]) => {
  if (viewer.getScene() !== scene || !viewer.isLoaded()) {
    const loaded = new Promise((resolve) => viewer.on("load", resolve));
    viewer.loadScene(scene);
    await loaded;
  }
  const north = viewer.getNorthOffset(), radians = Math.PI / 180, colors = [];
  for (const [heading, pitch] of views) {
    const shown = new Image();
    const url = viewer.getRenderer().render(pitch * radians, (heading - north) * radians, 60 * radians, { returnImage: true });
    shown.src = url;
    await shown.decode();
    const canvas = new OffscreenCanvas(shown.width, shown.height), pen = canvas.getContext("2d");
    pen.drawImage(shown, 0, 0);
    colors.push([...pen.getImageData(shown.width / 2 - 8, shown.height / 2 - 8, 16, 16).data]);
  }
  return colors;
}"""


def test_pannellum_shows_directions_and_links_where_they_are(chromium: Browser, tour: Tour, tmp_path: Path) -> None:
    with opened(chromium, "pannellum", tour, tmp_path) as page:
        assert has_all_photos(page, tour)
        page.wait_for_function("viewer.isLoaded()")
        scenes = json.loads((tmp_path / "pannellum.json").read_text())["scenes"]
        for number, (name, scene) in enumerate(scenes.items()):
            linked = [list(scenes).index(spot["sceneId"]) for spot in scene["hotSpots"]]
            wanted = expected_and_links(tour, number, linked)
            views = headings_of(wanted[:24]) + [
                [spot["yaw"] + scene["northOffset"], spot["pitch"]] for spot in scene["hotSpots"]
            ]
            assert worst_deg(page.evaluate(LOOK_WITH_PANNELLUM, [name, views]), wanted) < LIMIT_DEG, name


SHOWN = {
    "psv": "viewer.getPlugin('virtual-tour').getCurrentNode()?.id",
    "pannellum": "viewer.isLoaded() && viewer.getScene()",
}


@pytest.mark.parametrize("name", ["psv", "pannellum"])
def test_a_photo_is_shown_that_is_chosen_while_the_first_still_loads(
    name: ExportFormat, chromium: Browser, tour: Tour, tmp_path: Path
) -> None:
    held: list[Route] = []
    with opened(chromium, name, tour, tmp_path) as page:
        assert has_all_photos(page, tour)
        page.wait_for_function(SHOWN[name])
        # Not `times=1`: the browser would pass the one that is held on, once in a while, when it hears of that.
        page.route("**/hall*", lambda route: route.fallback() if held else held.append(route))
        with page.expect_request("**/hall*"):
            page.reload()
        photos = page.locator("#photos")
        photos.select_option(index=3)
        held[0].fulfill(path=tmp_path / tour.photos[0].name, content_type="image/jpeg")
        page.wait_for_function(f"document.getElementById('photos').value === ({SHOWN[name]})")
        assert photos.evaluate("photos => photos.selectedIndex") == 3


POTREE = """window.Potree = {
  Viewer: function () {
    const view = { setView: (...places) => { window.view = places; } };
    Object.assign(this, { setPointBudget() {}, loadGUI() {}, scene: { add360Images: (all) => { window.shown = all; }, view } });
  },
  loadPointCloud: (path) => { window.cloud = path; },
  Images360Loader: {
    load: async (folder) => ({ images: [{ position: [1, 2, 3] }], text: await (await fetch(`${folder}/coordinates.txt`)).text() }),
  },
};"""


def test_the_page_of_potree_loads_the_photos_and_the_cloud_that_lie_beside_it(
    chromium: Browser, tour: Tour, tmp_path: Path
) -> None:
    """With what Potree offers to pages, because no registry has Potree 1.8."""
    page_text = written("potree", tour, tmp_path).joinpath("index.html").read_text()
    for path in [*re.findall(r'(?:src|href)="../../([^"]+)"', page_text), "pointcloud/metadata.json"]:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(POTREE if path == "build/potree/potree.js" else "")
    with opened(chromium, "potree", tour, tmp_path) as page:
        page.wait_for_function("window.view")
        assert page.evaluate("shown.text") == (tmp_path / "coordinates.txt").read_text()
        assert page.evaluate("[cloud, view[1]]") == ["pointcloud/metadata.json", [1, 2, 3]]


def test_files_of_the_mirror_are_those_of_the_packages() -> None:
    import hashlib

    for path, digest in DIGESTS.items():
        file = MODULES / re.sub(r"@[\d.]+", "", path)
        assert base64.b64encode(hashlib.sha384(file.read_bytes()).digest()).decode() == digest, path
