"""What people do in the console, in a browser: from a dropped scan to standing where a photo was taken, and what changed since."""

import json
import re
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, Route, expect

from panoloc.core.scan.ply.writer import encode_ply
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from tests.integration.console_page import (
    WAIT_MS,
    best_shift,
    browser,
    edges,
    page_of,
    picture_of,
    scene_state,
    serious_faults,
    wait_until_drawn,
)
from tests.integration.running_service import RunningService
from tests.integration.small_room import second_panorama, small_room

pytestmark = [pytest.mark.integration, pytest.mark.slow]

HOSTILE = "<img src=x onerror=alert(1)>"
STAND_HERE, STEP_OUT = "Stand here", "Step out"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    data_dir = tmp_path_factory.mktemp("console") / "data"
    demo = data_dir / "demo"
    demo.mkdir(parents=True)
    # The room of the tests is made within a second, that of the demo within many.
    (demo / "room.ply").write_bytes(small_room().scan)
    (demo / "panorama.jpg").write_bytes(small_room().panorama)
    running = RunningService(data_dir)
    running.wait_until_ready()
    yield running
    running.stop()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def room_id(service: RunningService, chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Drop a scan with a hostile name, and return the id of the map that it becomes."""
    scan = tmp_path_factory.mktemp("scans") / HOSTILE
    scan.write_bytes(small_room().scan)
    with page_of(chromium, str(service.http.base_url)) as page:
        page.get_by_label("Choose scans to upload").set_input_files(scan)
        card = page.get_by_role("link", name=HOSTILE)
        expect(card.locator("img")).to_be_visible(timeout=WAIT_MS)
        expect(card).to_contain_text("points")
        assert page.locator("img[src=x]").count() == 0
        return str(card.get_attribute("href")).rpartition("/")[2]


@pytest.fixture(scope="module")
def panorama(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("photos") / "panorama.jpg"
    file.write_bytes(small_room().panorama)
    return file


@pytest.fixture
def page(service: RunningService, chromium: Browser) -> Iterator[Page]:
    with page_of(chromium, str(service.http.base_url)) as opened:
        yield opened


def test_a_file_that_is_no_scan_is_refused_with_what_to_do_and_can_be_dismissed(page: Page, tmp_path: Path) -> None:
    wrong = tmp_path / "holiday.ply"
    wrong.write_bytes(b"this is no scan")
    page.get_by_label("Choose scans to upload").set_input_files(wrong)
    note = page.get_by_role("alert").filter(has_text="Request")
    expect(note).to_contain_text("expected")
    page.get_by_role("button", name="Dismiss").click()
    expect(note).to_have_count(0)


@pytest.mark.parametrize(("draw", "drawn_by"), [("webgl", "WebGL"), ("processor", "the processor")])
def test_photo_and_points_meet_where_the_photo_was_taken(
    page: Page, service: RunningService, room_id: str, panorama: Path, tmp_path: Path, draw: str, drawn_by: str
) -> None:
    page.goto(f"{service.http.base_url}/?draw={draw}#/maps/{room_id}")
    wait_until_drawn(page, _num_stored_points(service, room_id))
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    page.get_by_role("button", name=STAND_HERE).click()
    expect(page.get_by_role("button", name=STEP_OUT)).to_be_visible()
    assert scene_state(page)["isStanding"]
    assert scene_state(page)["renderer"].startswith(drawn_by)
    slider = page.get_by_label("From points to photo")
    slider.fill("0")
    points = picture_of(page, tmp_path, "points")
    slider.fill("1")
    photo = picture_of(page, tmp_path, "photo")
    shift, agreement = best_shift(edges(points), edges(photo))
    assert np.hypot(*shift) <= 4, (shift, agreement)
    assert agreement > 0.3
    assert serious_faults(page) == []


def test_what_the_answer_saw_changed_is_shown_as_pictures_and_with_the_map(
    page: Page, service: RunningService, room_id: str, panorama: Path
) -> None:
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    for name in ("Photo", "Scan", "Side by side"):
        page.get_by_label("What changed").get_by_role("button", name=name).click()
        expect(page.get_by_label("What changed").locator("img")).to_be_visible()
    page.get_by_role("button", name="Changes").click()
    kept = page.get_by_label("Answers that count, newest first").get_by_role("listitem")
    expect(kept.first).to_contain_text("%")
    assert serious_faults(page) == []


def test_places_that_fit_are_stepped_through(page: Page, service: RunningService, room_id: str, panorama: Path) -> None:
    def with_rival(route: Route) -> None:
        answer: dict[str, Any] = route.fetch().json()
        if answer.get("pose") is not None:
            rival = {"pose": answer["pose"], "confidence": 0.25, "map_id": room_id}
            answer |= {"status": "ambiguous", "confidence": 0.5, "alternatives": [rival]}
        route.fulfill(json=answer)

    page.route(re.compile(r"/localizations/loc_\w+$"), with_rival)
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    places = page.get_by_role("group", name="Places that fit")
    expect(places).to_contain_text("Place 1 of 2")
    places.get_by_role("button", name="Next place").click()
    expect(places).to_contain_text("Place 2 of 2 · 25")
    expect(page.get_by_label("Answer", exact=True)).to_contain_text("Several places fit")


def test_a_map_has_a_code_that_opens_it_on_phones(page: Page, service: RunningService, room_id: str) -> None:
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_role("button", name="About").click()
    page.get_by_role("button", name="For phones").click()
    code = page.get_by_role("img", name="QR code of the link below")
    expect(code).to_be_visible()
    assert code.evaluate("image => image.complete && image.naturalWidth > 0")
    link = page.get_by_role("dialog").get_by_role("link")
    expect(link).to_have_attribute("href", re.compile(rf"^http://127.0.0.1:{service.port}/m/{room_id}$"))
    assert serious_faults(page) == []


def test_a_batch_is_a_tour_with_a_plan_reasons_and_an_export(
    page: Page, service: RunningService, room_id: str, panorama: Path, tmp_path: Path
) -> None:
    (other := tmp_path / "other.jpg").write_bytes(second_panorama())
    notes = tmp_path / "notes.txt"
    notes.write_text("no image")
    page.goto(f"{service.http.base_url}/#/localize")
    page.get_by_role("checkbox", name=HOSTILE).check()
    page.get_by_role("checkbox", name="Keep as a batch").check()
    page.get_by_label("Choose photos to localize").set_input_files([panorama, other, notes])
    placed = page.get_by_role("region", name="Placed photos")
    expect(placed.get_by_role("button")).to_have_count(2)
    expect(page.get_by_role("region", name="Photos without a place")).to_contain_text("notes.txt")
    expect(page.get_by_role("region", name="Plan").locator(".marker")).to_have_count(2)
    batch_page = page.url
    page.goto(f"{service.http.base_url}/#/batches")
    expect(page.get_by_role("list", name="Batches").get_by_role("link").first).to_contain_text("3 photos")
    assert serious_faults(page) == []
    page.goto(batch_page)
    page.get_by_role("button", name="Begin the tour").press("Enter")
    expect(page.get_by_label("in 3D")).to_be_focused()
    page.get_by_role("group", name="To the photos around").get_by_role("button", name="To other.jpg").click()
    expect(placed.get_by_role("button", name="other.jpg")).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("button", name="To panorama.jpg")).to_be_visible()
    page.get_by_label("Format").select_option("potree")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    with zipfile.ZipFile(download.value.path()) as archive:
        assert "unplaced.txt" in archive.namelist()
    assert serious_faults(page) == []
    page.get_by_role("button", name="Delete this batch…").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_role("heading", name="Batches", exact=True)).to_be_visible()


def test_the_demo_room_takes_one_click_can_be_renamed_and_is_deleted_only_when_asked_twice(
    page: Page, service: RunningService
) -> None:
    (page.get_by_role("button", name="Try the demo room")).click()
    expect(page.get_by_role("heading", name="Demo room")).to_be_visible(timeout=WAIT_MS)
    expect(page.get_by_role("button", name=STAND_HERE)).to_be_visible(timeout=WAIT_MS)
    expect(page.get_by_label("Answer", exact=True).get_by_role("heading")).to_have_text("Almost certain")
    map_id = page.url.split("/maps/")[1].partition("/")[0]
    page.get_by_role("button", name="About").click()
    page.get_by_role("button", name="Edit…").click()
    page.get_by_label("Name", exact=True).fill("renamed")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="renamed")).to_be_visible()
    assert service.map(map_id)["name"] == "renamed"
    asking = page.get_by_role("button", name="Delete this map…")
    asking.press("Enter")
    expect(page.get_by_role("button", name="Keep")).to_be_focused()
    assert serious_faults(page) == []
    page.keyboard.press("Escape")
    expect(asking).to_be_focused()
    asking.click()
    assert service.status(f"/maps/{map_id}") == 200
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_role("heading", name="Maps")).to_be_visible()
    assert service.status(f"/maps/{map_id}") == 404


def test_a_service_that_is_busy_is_asked_again_when_it_says_so(page: Page, service: RunningService) -> None:
    asked: list[str] = []

    def busy_once(route: Route) -> None:
        asked.append(route.request.url)
        if len(asked) == 1:
            route.fulfill(status=429, headers={"Retry-After": "3"}, json={"detail": "expected a shorter queue"})
        else:
            route.continue_()

    page.route(re.compile(r"/batches\?"), busy_once)
    page.goto(f"{service.http.base_url}/#/batches")
    expect(page.get_by_text("The page retries in 3 s")).to_be_visible()
    expect(
        page.get_by_role("link", name="Localize photos").or_(page.get_by_role("list", name="Batches"))
    ).to_be_visible()
    expect(page.get_by_text("The page retries in")).to_have_count(0)
    assert len(asked) >= 2


def test_a_service_that_goes_is_said_to_be_gone_until_it_is_back(page: Page) -> None:
    gone = page.get_by_role("alert").filter(has_text="The service does not answer")
    expect(page.get_by_role("banner")).to_contain_text("Ready")
    page.context.set_offline(True)
    expect(gone).to_be_visible(timeout=WAIT_MS)
    page.context.set_offline(False)
    expect(gone).to_have_count(0, timeout=WAIT_MS)
    expect(page.get_by_role("banner")).to_contain_text("Ready")


def test_the_scan_is_turned_moved_and_zoomed_by_keys_that_the_view_names(
    page: Page, service: RunningService, room_id: str
) -> None:
    def view() -> NDArray[np.float64]:
        middle_and_eye = "({orbit, camera}) => [orbit.target.toArray(), camera.position.toArray()]"
        found = page.evaluate(f"({middle_and_eye})(document.querySelector('canvas[data-scene]').stage)")
        return np.array(found)

    page.get_by_role("link", name=HOSTILE).press("Enter")
    expect(page.get_by_role("main")).to_be_focused()
    wait_until_drawn(page, _num_stored_points(service, room_id))
    page.keyboard.press("Tab")
    expect(page.get_by_label("in 3D")).to_be_focused()
    expect(page.get_by_text("with Shift move")).to_be_visible()
    begun = view()
    page.keyboard.press("ArrowRight")
    turned = view()
    page.keyboard.press("Shift+ArrowUp")
    moved = view()
    page.keyboard.press("+")
    zoomed = view()
    away = [np.linalg.norm(eye - middle) for middle, eye in (begun, turned, moved, zoomed)]
    assert np.allclose(begun[0], turned[0])
    assert np.linalg.norm(turned[1] - begun[1]) > 0.05 * away[0]
    assert np.allclose(moved - turned, moved[0] - turned[0])
    assert np.linalg.norm(moved[0] - turned[0]) > 0.02 * away[0]
    assert away[0] == pytest.approx(away[1]) == pytest.approx(away[2])
    assert zoomed[0] == pytest.approx(moved[0])
    assert away[3] < 0.9 * away[2]
    page.get_by_role("checkbox", name="Starts of the search").check()
    num_starts = service.map(room_id)["stats"]["num_starts"]
    expect(page.get_by_text(f"Starts of the search ({num_starts})")).to_be_visible()


def test_an_ordinary_photo_of_which_nothing_is_known_is_asked_for_its_angle_of_view(
    page: Page, service: RunningService, room_id: str, tmp_path: Path
) -> None:
    photo = tmp_path / "wall.png"
    Image.fromarray(np.full((60, 80, 3), 128, np.uint8)).save(photo)
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_label("Choose photos to localize").set_input_files(photo)
    expect(page.get_by_role("alert").filter(has_text="What is the field of view of this photo?")).to_be_visible()
    # The search itself is none of the page's; what the page asks for is.
    page.route(re.compile(r"/localize$"), lambda route: route.abort())
    page.evaluate(
        """() => {
            const { append } = FormData.prototype;
            FormData.prototype.append = function (name, ...rest) {
                if (name === "options") window.askedFor = rest[0];
                return append.call(this, name, ...rest);
            };
        }"""
    )
    page.get_by_role("button", name="Search 45° to 90°").click()
    expect(page.get_by_role("alert").filter(has_text="The connection was interrupted")).to_be_visible()
    asked_for = json.loads(page.evaluate("window.askedFor"))
    assert asked_for["cameras"] == [{"model": "pinhole", "hfov_range_deg": [45, 90]}]
    page.get_by_role("button", name="Remove wall.png").click()
    expect(page.get_by_text("wall.png")).to_have_count(0)


def test_an_upload_that_broke_off_is_sent_again_when_asked_to(page: Page, tmp_path: Path) -> None:
    (scan := tmp_path / "broken off.ply").write_bytes(small_room().scan)
    page.route(re.compile(r"/maps$"), lambda route: route.abort("connectionreset"))
    page.get_by_label("Choose scans to upload").set_input_files(scan)
    expect(page.get_by_role("alert").filter(has_text="The connection was interrupted")).to_be_visible()
    page.unroute_all()
    page.get_by_role("button", name="Try again").click()
    page.get_by_role("link", name="broken off.ply").click()
    page.get_by_role("button", name="About").click()
    page.get_by_role("button", name="Delete this map…").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_role("heading", name="Maps")).to_be_visible()


@pytest.mark.parametrize(("scheme", "width"), [("light", 1100), ("dark", 390)])
def test_every_view_can_be_read_and_reached_by_everybody(
    service: RunningService, chromium: Browser, room_id: str, scheme: Any, width: int
) -> None:
    address = str(service.http.base_url)
    with page_of(chromium, address, color_scheme=scheme, viewport={"width": width, "height": 800}) as page:

        def check(path: str, *presses: str) -> None:
            page.goto(f"{address}/#{path}")
            for name in presses:
                page.get_by_role("button", name=name).click()
            expect(page.get_by_role("heading").first).to_be_visible()
            assert serious_faults(page) == [], (path, presses)
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (path, presses)

        expect(page.get_by_role("link", name=HOSTILE)).to_be_visible()
        check("/maps")
        check("/localize")
        expect(page.get_by_role("checkbox", name=HOSTILE)).to_be_visible()
        for path in (f"/maps/{room_id}", "/batches", "/maps/map_none"):
            check(path)
        request_id = service.http.get("/maps/map_none").headers["x-request-id"]
        check("/operations")
        expect(page.get_by_role("list", name="State")).to_contain_text("Workers")
        expect(page.get_by_role("region", name="Last problems").first).to_contain_text(request_id)
        check(f"/maps/{room_id}", "Changes")
        check(f"/maps/{room_id}", "About", "Edit…")
        check("/operations", "Key")


def _num_stored_points(service: RunningService, map_id: str) -> int:
    points = service.http.get(f"/maps/{map_id}/points?max_points=10000000").content
    header, _, body = points.partition(b"end_header\n")
    assert b"property float x" in header
    return len(body) // struct.calcsize("<fffBBB")


def test_a_scan_that_lies_on_its_side_in_feet_is_asked_about_and_two_clicks_mend_it(
    page: Page, service: RunningService, tmp_path: Path
) -> None:
    room = scan_scene(build_scene(SceneSpec("bare", 207)), num_points=40_000, seed=207)
    turned = room.positions[:, [0, 2, 1]].astype(np.float64) * [1, 1, -1] / 0.3048  # y up, as models have it
    scan = tmp_path / "on its side.ply"
    scan.write_bytes(encode_ply(replace(room, positions=turned.astype(np.float32))))
    page.get_by_label("Choose scans to upload").set_input_files(scan)
    card = page.get_by_role("link", name=scan.name)
    expect(card).to_contain_text("points")
    map_id = str(card.get_attribute("href")).rpartition("/")[2]
    card.click()
    reading = page.get_by_label("How the scan was read")
    expect(reading).to_contain_text("Which axis of the scan points up?")
    expect(reading.get_by_role("img", name="A person of 1.75 m in a storey of 8.4").first).to_be_visible()
    assert serious_faults(page) == []
    reading.get_by_role("button", name=re.compile(r"(?<!-)y up")).click()
    expect(reading).not_to_contain_text("Which axis")
    expect(reading).to_contain_text("y up (as given)")
    reading.get_by_role("button", name="all in feet").click()
    expect(reading.get_by_role("button")).to_have_count(0)
    page.get_by_role("button", name="About").click()
    expect(reading).to_contain_text("Read in feet (as given)")
    found = service.http.get(f"/maps/{map_id}").json()
    assert (found["status"], found["serving_revision"]) == ("ready", 3)
    corners = [found["stats"]["bounds"][end] for end in ("min", "max")]
    np.testing.assert_allclose(np.subtract(corners[1], corners[0]), np.ptp(room.positions, axis=0), atol=0.03)
