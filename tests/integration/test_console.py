"""What people do in the console, in a browser: from a dropped scan to standing where a photo was taken, and what changed since."""

import json
import math
import re
import struct
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, Route, expect

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from tests.core.found_pose import known
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
    wait_until_still,
)
from tests.integration.known_points import known_points, seen_from, seen_from_above
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import (
    OPTIONS,
    dense_scan,
    fine_panorama,
    rearranged_panoramas,
    room_scene,
    second_panorama,
    small_room,
    two_storeys,
)

pytestmark = [pytest.mark.integration, pytest.mark.slow]

HOSTILE = "<img src=x onerror=alert(1)>"
_PANORAMA = Camera("equirectangular", 512, 256, 256 / math.pi, 256 / math.pi, 256, 128)
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
def page(chromium: Browser) -> Iterator[Page]:
    with page_of(chromium, "about:blank") as opened:
        yield opened


def test_a_file_that_is_no_scan_is_refused_with_what_to_do_and_can_be_dismissed(
    page: Page, service: RunningService, tmp_path: Path
) -> None:
    wrong = tmp_path / "holiday.ply"
    wrong.write_bytes(b"this is no scan")
    page.goto(str(service.http.base_url))
    page.get_by_label("Choose scans to upload").set_input_files(wrong)
    note = page.get_by_role("alert").filter(has_text="Request")
    expect(note).to_contain_text("Expected a scan")
    page.get_by_role("button", name="Dismiss").click()
    expect(note).to_have_count(0)


@pytest.mark.parametrize(("draw", "drawn_by"), [("webgl", "WebGL"), ("processor", "the processor")])
def test_photo_and_points_meet_where_the_photo_was_taken(
    page: Page, service: RunningService, room_id: str, tmp_path: Path, draw: str, drawn_by: str
) -> None:
    panorama = tmp_path / "panorama.jpg"
    panorama.write_bytes(fine_panorama())
    page.goto(f"{service.http.base_url}/?draw={draw}#/maps/{room_id}")
    wait_until_drawn(page, _num_stored_points(service, room_id))
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    heading = "document.querySelector('canvas[data-scene]').stage.heading"
    page.evaluate("document.querySelector('canvas[data-scene]').stage.spin(40)")
    wait_until_still(page)
    looked_to = page.evaluate(heading)
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
    page.get_by_role("button", name=STEP_OUT).click()
    wait_until_still(page)
    assert page.evaluate(heading) == pytest.approx(looked_to)


def test_what_the_answer_saw_changed_is_shown_as_pictures_and_with_the_map(
    page: Page, service: RunningService, room_id: str, panorama: Path, tmp_path: Path
) -> None:
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    for name in ("Photo", "Scan", "Before and after"):
        page.get_by_label("What changed").get_by_role("button", name=name).click()
        expect(page.get_by_label("What changed").locator("img").first).to_be_visible()
    page.get_by_role("button", name="Enlarge").click()
    page.get_by_role("dialog").get_by_label("Edge between photo and scan").fill("20")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Changes").click()
    kept = page.get_by_label("Answers that count, newest first").get_by_role("listitem")
    expect(kept.first).to_contain_text("%")
    assert serious_faults(page) == []
    page.get_by_role("button", name="Photos", exact=True).click()
    _place_a_lost_photo_of_the_list(page, service, tmp_path / "lost.png")
    page.go_back()
    expect(page.get_by_role("list", name="Photos of batches").get_by_text("lost.png")).to_be_visible()
    expect(page.get_by_role("list", name="Photos and their answers")).to_have_count(0)
    expect(page.get_by_label("Answer", exact=True)).to_have_count(0)


def _place_a_lost_photo_of_the_list(page: Page, service: RunningService, lost: Path) -> None:
    """Drop a photo that is not found, and place it by hand in the batch that all photos of the list become."""
    Image.new("RGB", (512, 256), "grey").save(lost)
    page.get_by_label("Choose photos to localize").set_input_files(lost)
    page.get_by_role("button", name="Place lost.png by hand").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("lost.png")
    page.get_by_role("button", name="Drag on the plan").click()
    expect(page.get_by_role("alert")).to_have_count(0)
    assert serious_faults(page) == []
    batch_id, _, number = page.url.rpartition("/batches/")[2].partition("/place/")
    assert eventually(lambda: service.http.get(f"/batches/{batch_id}").json()["status"] == "done", 60)
    items = service.http.get(f"/batches/{batch_id}").json()["items"]
    assert [(each["name"], each["status"]) for each in items] == [
        ("lost.png", "not_localized"),
        ("panorama.jpg", "localized"),
    ]
    pose = {"frame": "ros", "map_from_camera": items[1]["answer"]["pose"]["map_from_camera"]}
    body = {"map_id": items[1]["answer"]["map_id"], "pose": pose, "refine": False, "confirm": True}
    service.http.post(f"/batches/{batch_id}/images/{number}/pose", json=body).raise_for_status()


def test_objects_that_changed_are_listed_with_pictures_and_reports(
    page: Page, service: RunningService, tmp_path: Path
) -> None:
    map_id = service.register(small_room().scan, OPTIONS)
    files = [("image", (f"{number}.jpg", data)) for number, data in enumerate(rearranged_panoramas())]
    batch_id = service.http.post("/batches", files=files, data={"map_id": map_id}).json()["id"]
    assert eventually(lambda: service.http.get(f"/batches/{batch_id}").json()["status"] == "done", 240)
    objects = service.http.get(f"/maps/{map_id}/changes").json()["objects"]
    assert {each["is_sure"] for each in objects} == {True, False}
    page.goto(f"{service.http.base_url}/#/maps/{map_id}")
    page.get_by_role("button", name="Changes").click()
    for label, is_sure in (("Objects that changed, the surest first", True), ("Objects that may have changed", False)):
        shown = page.get_by_role("list", name=label)
        if not is_sure:
            page.get_by_text("unsure").click()
        expect(shown.get_by_role("listitem")).to_have_count(sum(each["is_sure"] is is_sure for each in objects))
        shown.get_by_role("button").first.click()
        picture = shown.get_by_role("img", name="Photo on the left, scan on the right")
        expect(picture).to_be_visible()
        assert picture.evaluate("image => image.decode().then(() => image.naturalWidth)") == 644
        assert serious_faults(page) == []
    for wanted, first in {"pdf": b"%PDF-", "html": b"<!doctype html>"}.items():
        page.get_by_label("Report").select_option(wanted)
        with page.expect_download() as report:
            page.get_by_role("button", name="Download report").click()
        report.value.save_as(file := tmp_path / wanted)
        assert file.read_bytes().startswith(first)
    page.goto((tmp_path / "html").replace(tmp_path / "report.html").as_uri())
    expect(page.get_by_role("img", name="Photo and scan of change")).to_have_count(len(objects))
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


def _walk_through_an_export(page: Page, chromium: Browser, folder: Path) -> None:
    """Download a walk-through, open it from its folder on a phone's screen, and walk to the other photo."""
    page.get_by_label("Format").select_option("tour")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    with zipfile.ZipFile(download.value.path()) as archive:
        archive.extractall(folder)
    assert "notes.txt" in (folder / "unplaced.txt").read_text()
    requests: list[str] = []
    with page_of(chromium, "about:blank", viewport={"width": 390, "height": 844}) as walk:
        walk.on("request", lambda request: requests.append(request.url))
        walk.goto((folder / "index.html").as_uri())
        here = walk.locator("canvas[data-here]")
        expect(here).to_have_attribute("data-here", "0")
        arrow = walk.get_by_role("group", name="To the photos around").get_by_role("button", name="To other.jpg")
        # One looks to where one can walk.
        heading = _heading_to_the_other(walk)
        assert abs(float(here.get_attribute("data-yaw") or "nan") - heading) < 1e-3
        before = here.screenshot()
        arrow.click()
        expect(here).to_have_attribute("data-here", "1")
        expect(walk.get_by_role("status")).to_have_text("other.jpg")
        assert abs(float(here.get_attribute("data-yaw") or "nan") - heading) < 1e-3
        assert here.screenshot() != before
        walk.get_by_role("button", name="Photos").click()
        expect(walk.get_by_label("All photos").get_by_role("button")).to_have_count(2)
        assert serious_faults(walk) == []
        walk.get_by_role("button", name="Plan").click()
        expect(walk.get_by_role("img", name="Floor 1 from above")).to_be_visible()
        assert walk.get_by_role("img").evaluate("image => image.naturalWidth") > 100
        walk.locator("[data-stop='0']").click()
        expect(here).to_have_attribute("data-here", "0")
        assert serious_faults(walk) == []
    inside = (folder.as_uri(), "data:", "blob:")
    assert requests
    assert [url for url in requests if not url.startswith(inside)] == []


def _heading_to_the_other(walk: Page) -> float:
    one, other = (photo["position"] for photo in walk.evaluate("window.panolocWalk.photos"))
    return float(np.arctan2(other[1] - one[1], other[0] - one[0]))


def test_a_batch_is_a_tour_with_a_plan_reasons_and_an_export(
    page: Page, chromium: Browser, service: RunningService, room_id: str, panorama: Path, tmp_path: Path
) -> None:
    (other := tmp_path / "other.jpg").write_bytes(second_panorama())
    notes = tmp_path / "notes.txt"
    notes.write_text("no image")
    page.goto(f"{service.http.base_url}/#/localize")
    page.get_by_role("checkbox", name=HOSTILE).check()
    page.get_by_role("checkbox", name="Keep as a batch").check()
    page.get_by_label("Name of the batch").fill("North wing")
    page.get_by_label("Choose photos to localize").set_input_files([panorama, other, notes])
    placed = page.get_by_role("region", name="Placed photos")
    expect(placed.get_by_role("listitem")).to_have_count(2)
    expect(page.get_by_role("region", name="Photos not placed")).to_contain_text("notes.txt")
    expect(page.get_by_role("region", name="Plan").locator(".marker")).to_have_count(2)
    batch_page = page.url
    page.goto(f"{service.http.base_url}/#/batches")
    expect(page.get_by_role("list", name="Batches").get_by_role("link").first).to_contain_text("North wing")
    assert serious_faults(page) == []
    page.goto(batch_page)
    page.get_by_role("button", name="Rename").click()
    page.get_by_label("Name of the batch").fill("South wing")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_have_text("South wing")
    page.get_by_role("button", name="Begin the tour").press("Enter")
    expect(page.get_by_label("in 3D")).to_be_focused()
    page.get_by_role("group", name="To the photos around").get_by_role("button", name="To panorama.jpg").click()
    expect(placed.get_by_role("button", name="panorama.jpg").last).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("button", name="To other.jpg")).to_be_visible()
    expect(page.get_by_role("region", name="Plan")).to_contain_text("from the map's y axis")
    placed.get_by_role("button", name="Enlarge panorama.jpg").click()
    expect(page.get_by_role("dialog").get_by_role("heading")).to_have_text("panorama.jpg")
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("dialog").get_by_role("heading")).to_have_text("notes.txt")
    page.keyboard.press("Escape")
    page.get_by_label("Format").select_option("potree")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    with zipfile.ZipFile(download.value.path()) as archive:
        assert "unplaced.txt" in archive.namelist()
    assert serious_faults(page) == []
    _walk_through_an_export(page, chromium, tmp_path / "walk")
    page.get_by_role("button", name="Delete this batch…").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_role("heading", name="Batches", exact=True)).to_be_visible()


@pytest.fixture
def lost_batch(service: RunningService, room_id: str, panorama: Path) -> str:
    """Return a batch whose photo is not found, because a wrong heading was said of it."""
    heading = math.degrees(small_room().pose.yaw_pitch_roll[0]) % 360 - 180
    options = json.dumps({"hints": {"heading_deg": heading, "heading_tolerance_deg": 15}})
    files = [("image", ("lost.jpg", panorama.read_bytes()))]
    batch_id = service.http.post("/batches", files=files, data={"map_id": room_id, "options": options}).json()["id"]
    assert eventually(lambda: service.http.get(f"/batches/{batch_id}").json()["status"] == "done", 60)
    assert service.http.get(f"/batches/{batch_id}").json()["counts"]["not_localized"] == 1
    return str(batch_id)


@pytest.fixture
def wide(chromium: Browser) -> Iterator[Page]:
    with page_of(chromium, "about:blank", viewport={"width": 1440, "height": 800}) as opened:
        yield opened


def test_a_lost_photo_is_placed_by_points_clicked_in_photo_and_scan(
    wide: Page, service: RunningService, room_id: str, lost_batch: str
) -> None:
    wide.goto(f"{service.http.base_url}/#/batches/{lost_batch}")
    wide.get_by_role("link", name="Place by hand").click()
    wait_until_drawn(wide, _num_stored_points(service, room_id))
    said = wide.get_by_role("region", name="Where it is").get_by_role("status")
    photo, solve = wide.get_by_role("application", name="lost.jpg"), wide.get_by_role("button", name="Solve and refine")
    for number, (right, down) in enumerate([(0.35, 0.4), (0.65, 0.42), (0.5, 0.6), (0.4, 0.7)], 1):
        if number == 4:
            wide.reload()  # which keeps the points
            wait_until_drawn(wide, _num_stored_points(service, room_id))
            wide.get_by_role("button", name="Stand inside").click()
            assert eventually(lambda: scene_state(wide)["isStanding"], 10)
        scan = known(wide.locator("canvas[data-scene]").bounding_box())
        wide.mouse.click(scan["x"] + right * scan["width"], scan["y"] + down * scan["height"])
        expect(said).to_contain_text(f"Now click point {number}, at")
        at = np.array([float(value) for value in re.findall(r"(-?\d+\.\d{3})", str(said.text_content()))])
        u, v, _ = project_to_image(_PANORAMA, (at - small_room().pose.position) @ small_room().pose.rotation)
        shown = known(photo.locator("img").bounding_box())
        photo.locator("img").click(
            position={"x": float(u) / 512 * shown["width"], "y": float(v) / 256 * shown["height"]}
        )
        expect(said).to_contain_text(f"point {number + 1}")
    solve.click()
    expect(wide.get_by_role("radio", name="Refined")).to_be_checked()
    assert serious_faults(wide) == []
    wide.get_by_role("button", name="Confirm this place").click()
    expect(wide.get_by_role("region", name="Placed photos")).to_contain_text("lost.jpg")
    (item,) = service.http.get(f"/batches/{lost_batch}").json()["items"]
    assert (item["status"], item["answer"]["placed_by"]) == ("localized", "hand")
    assert small_room().error_of(item["answer"]).within(0.05, 1.0)


def test_a_lost_photo_is_dragged_to_its_place_and_that_can_be_undone(
    wide: Page, service: RunningService, room_id: str, lost_batch: str
) -> None:
    wide.goto(f"{service.http.base_url}/#/batches/{lost_batch}/place/0")
    wide.get_by_role("button", name="Drag on the plan").click()
    plan = wide.get_by_role("application", name="Plan of")
    box, bounds = known(plan.bounding_box()), service.http.get(f"/maps/{room_id}").json()["stats"]["bounds"]
    margin = 0.03 * max(high - low for low, high in zip(bounds["min"][:2], bounds["max"][:2], strict=True))
    left, top = bounds["min"][0] - margin, bounds["max"][1] + margin
    per_metre = box["width"] / (bounds["max"][0] - bounds["min"][0] + 2 * margin)
    x, y, z = small_room().pose.position
    wide.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    wide.mouse.down()
    wide.mouse.move(box["x"] + (x + 0.3 - left) * per_metre, box["y"] + (top - y + 0.2) * per_metre, steps=3)
    wide.mouse.up()
    yaw, pitch, roll = (round(math.degrees(angle)) for angle in small_room().pose.yaw_pitch_roll)
    arrow = known(plan.locator(".turning path").bounding_box())
    wide.mouse.move(arrow["x"] + arrow["width"] / 2, arrow["y"] + arrow["height"] / 2)
    wide.mouse.down()
    towards = math.radians(yaw + 10)
    right, down = x + 0.3 + math.cos(towards) - left, top - y + 0.2 - math.sin(towards)
    wide.mouse.move(box["x"] + right * per_metre, box["y"] + down * per_metre, steps=3)
    wide.mouse.up()
    assert abs(float(wide.get_by_label("Looks to").input_value()) - (yaw + 10)) < 3
    for name, degrees in (("Looks up", 4 - pitch), ("Right side down", roll - 4)):
        wide.get_by_label(name).fill(str(degrees))
    wide.get_by_label("Height, m").fill("")
    expect(wide.get_by_role("button", name="Refine")).to_be_disabled()
    wide.get_by_label("Height, m").fill(f"{z + 0.15:.2f}")
    wide.get_by_role("button", name="Refine").click()
    expect(wide.get_by_role("radio", name="Refined")).to_be_checked()
    assert serious_faults(wide) == []
    wide.get_by_role("button", name="Confirm this place").click()
    wide.get_by_role("region", name="Placed photos").get_by_role("button", name="lost.jpg").last.click()
    expect(wide.get_by_text("lost.jpg was placed by hand.")).to_be_visible()
    (item,) = service.http.get(f"/batches/{lost_batch}").json()["items"]
    assert small_room().error_of(item["answer"]).within(0.05, 1.0)
    wide.get_by_role("link", name="Change or undo").click()
    wide.get_by_role("button", name="Undo").click()
    expect(wide.get_by_text("The answer of the search is back.")).to_be_visible()
    assert service.http.get(f"/batches/{lost_batch}").json()["counts"]["not_localized"] == 1


def test_control_points_are_loaded_clicked_and_give_the_map_its_place(
    wide: Page, service: RunningService, room_id: str, tmp_path: Path
) -> None:
    bounds = service.http.get(f"/maps/{room_id}").json()["stats"]["bounds"]
    (x0, y0, z0), (x1, y1, z1) = bounds["min"], bounds["max"]
    rows = ["name,x,y,z,map_x,map_y,map_z", "P5,691001,5334000,521,,,"]
    for number, (x, y, z) in enumerate([(x0, y0, z0), (x1, y0, z0), (x1, y1, z1), (x0, y1, z1)], 1):
        rows.append(f"P{number},{691000 + x:.4f},{5334000 + y:.4f},{520 + z + 0.004 * (-1) ** number:.4f},{x},{y},{z}")
    (points := tmp_path / "points.csv").write_text("\n".join(rows))
    wide.goto(f"{service.http.base_url}/#/maps/{room_id}")
    wide.get_by_role("button", name="About").click()
    wide.get_by_role("link", name="Control points").click()
    wide.get_by_label("Coordinate system").fill("EPSG:25832")
    wide.get_by_label("Geoid above ellipsoid, m").fill("46.2")
    wide.get_by_label("CSV with control points").set_input_files(points)
    expect(wide.get_by_role("region", name="Points", exact=True)).to_contain_text("up 4.0, 3D 4.")
    expect(wide.get_by_role("row", name="P5")).to_contain_text("–")
    wait_until_drawn(wide, _num_stored_points(service, room_id))
    scan = known(wide.locator("canvas[data-scene]").bounding_box())
    wide.mouse.click(scan["x"] + 0.5 * scan["width"], scan["y"] + 0.55 * scan["height"])
    expect(wide.get_by_text("No fit. Expected")).to_be_visible()  # it was another point of the room
    wide.get_by_role("button", name="Remove P5").click()
    expect(wide.get_by_role("row", name="P5")).to_have_count(0)
    assert serious_faults(wide) == []
    wide.get_by_role("button", name="Use as georeference").click()
    expect(wide.get_by_text("As the map stands")).to_be_visible()
    place = service.http.get(f"/maps/{room_id}").json()["georeference"]
    assert place["latitude_deg"] == pytest.approx(48.1306, abs=1e-3)
    assert place["height_m"] == pytest.approx(566.2, abs=0.01)
    service.http.patch(f"/maps/{room_id}", json={"georeference": None})


def test_the_demo_room_takes_one_click_can_be_renamed_and_is_deleted_only_when_asked_twice(
    page: Page, service: RunningService
) -> None:
    page.goto(str(service.http.base_url))
    page.get_by_role("button", name="Try the demo room").click()
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


def test_a_service_that_goes_is_said_to_be_gone_until_it_is_back(page: Page, service: RunningService) -> None:
    page.goto(str(service.http.base_url))
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
        middle_and_eye = "({outside, camera}) => [outside.orbit.target.toArray(), camera.position.toArray()]"
        found = page.evaluate(f"({middle_and_eye})(document.querySelector('canvas[data-scene]').stage)")
        return np.array(found)

    page.goto(str(service.http.base_url))
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
    page.get_by_role("checkbox", name="Starts").check()
    num_starts = service.map(room_id)["stats"]["num_starts"]
    expect(page.get_by_text(f"Starts ({num_starts})")).to_be_visible()


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
    assert asked_for["cameras"] == [{"model": "pinhole", "hfov_range_deg": [45, 90], "unless_panorama": True}]
    page.get_by_role("button", name="Remove wall.png").click()
    expect(page.get_by_text("wall.png")).to_have_count(0)


def test_an_upload_that_broke_off_is_sent_again_when_asked_to(
    page: Page, service: RunningService, tmp_path: Path
) -> None:
    (scan := tmp_path / "broken off.ply").write_bytes(small_room().scan)
    page.goto(str(service.http.base_url))
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


def test_known_points_are_measured_to_5_mm_on_the_plan_and_in_a_photo(
    page: Page, service: RunningService, panorama: Path
) -> None:
    def measure(rays: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
        page.get_by_role("button", name="Measure").click()
        wait_until_still(page)
        known = list(islice(known_points(page, room_scene(), origin, rays), 3))
        for point, at in known:
            page.mouse.click(*at)
            assert _figures(page, "Map x, y, z") == pytest.approx(point, abs=0.005)
        a, b, c = (point for point, _ in known)
        (length,), (height,), (area,) = (_figures(page, name) for name in ("Length", "Height difference", "Area"))
        assert length == pytest.approx(np.linalg.norm(b - a) + np.linalg.norm(c - b), abs=0.005)
        assert height == pytest.approx(c[2] - a[2], abs=0.005)
        assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a)) / 2, abs=0.01)
        assert serious_faults(page) == []
        page.get_by_role("button", name="Done").click()

    # Where the photo was taken is not in question here.
    eye = small_room().pose.position
    region = {"min": (eye - 0.6).tolist(), "max": (eye + 0.6).tolist()}
    options = {"starts": {"method": "grid", "spacing_m": 1.0, "region": region}}
    map_id = service.register(dense_scan(), json.dumps(options))
    page.goto(f"{service.http.base_url}/#/maps/{map_id}")
    wait_until_drawn(page, _num_stored_points(service, map_id))
    page.get_by_role("button", name="Plan", exact=True).click()
    bounds = service.map(map_id)["stats"]["bounds"]
    origin = np.floor((np.array(bounds["min"]) + bounds["max"]) / 2 + 0.5)
    section = float(page.get_by_label("Section height").input_value())
    measure(seen_from_above(np.array(bounds["min"]), np.array([*bounds["max"][:2], section])))
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    page.get_by_role("button", name=STAND_HERE).click()
    measure(seen_from(eye))


def test_photos_and_filters_of_a_map_outlive_a_reload(
    page: Page, service: RunningService, room_id: str, panorama: Path, tmp_path: Path
) -> None:
    (other := tmp_path / "other.jpg").write_bytes(second_panorama())
    photos = page.get_by_role("list", name="Photos and their answers").get_by_role("link")
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    page.get_by_label("Choose photos to localize").set_input_files([panorama, other])
    expect(photos).to_have_count(2)
    expect(page.get_by_role("button", name=STAND_HERE)).to_be_visible()
    page.get_by_label("Status").select_option("Found")
    page.reload()
    expect(photos).to_have_count(2)
    expect(page.get_by_label("Status")).to_have_value("localized")
    page.get_by_role("button", name=STAND_HERE).click()
    expect(page.get_by_label("From points to photo")).to_be_visible()
    page.get_by_role("button", name="Remove panorama.jpg").click()
    expect(photos).to_have_text(["other.jpg"])
    page.reload()
    # That the other one is back shows that they have been looked for.
    expect(photos).to_have_text(["other.jpg"])


def test_what_the_command_line_has_placed_is_a_batch_here(
    page: Page, service: RunningService, room_id: str, tmp_path: Path
) -> None:
    (photos := tmp_path / "photos").mkdir()
    (photos / "pano_19.jpg").write_bytes(small_room().panorama)
    (photos / "pano_2.jpg").write_bytes(second_panorama())
    address = str(service.http.base_url)
    arguments = [photos, "--map", room_id, "--out", tmp_path / "out", "--url", address, "--name", "Monday's round"]
    command = [sys.executable, "-P", "-m", "panoloc.service.cli", "place", *map(str, arguments)]
    subprocess.run(command, check=True, capture_output=True)
    page.goto(f"{address}/#/maps/{room_id}")
    kept = page.get_by_role("list", name="Photos of batches").get_by_role("link")
    page.get_by_role("combobox", name="Photos").select_option("Monday's round")
    expect(kept).to_have_count(2)
    expect(kept.first).to_contain_text("pano_2.jpg")
    kept.first.click()
    expect(page.get_by_label("Answer", exact=True)).to_be_visible()
    page.get_by_role("button", name=STAND_HERE).click()
    expect(page.get_by_label("From points to photo")).to_be_visible()
    page.goto(f"{address}/#/batches")
    batch = page.get_by_role("list", name="Batches").get_by_role("listitem").filter(has_text="Monday's round")
    expect(batch).to_contain_text("2 photos")
    expect(batch.locator("img")).to_be_visible()


def test_floors_of_a_building_are_shown_one_by_one(page: Page, service: RunningService) -> None:
    storeys = two_storeys()
    map_id = service.register(storeys.scan, OPTIONS, "two storeys.ply")
    page.goto(f"{service.http.base_url}/#/maps/{map_id}")
    floors = page.get_by_label("Floor", exact=True)
    floors.select_option("Floor 1 (0.0 m)")
    assert 1.5 < float(page.get_by_label("Section height").input_value()) < storeys.height_m
    wait_until_drawn(page, _num_stored_points(service, map_id))
    page.get_by_role("button", name="Plan", exact=True).click()
    page.get_by_role("button", name="Measure").click()
    page.get_by_label("in 3D").press("Enter")
    assert _figures(page, "Map x, y, z")[2] < storeys.height_m - 0.3
    floors.select_option(index=1)
    page.get_by_label("in 3D").press("Enter")
    assert _figures(page, "Map x, y, z")[2] > storeys.height_m - 0.1
    page.get_by_role("button", name="Reset").click()
    expect(floors).to_have_value("1")

    answer = service.localize(small_room().panorama, map_id).json()
    assert answer["status"] == "ambiguous"
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(f"{service.http.base_url}/#/maps/{map_id}/answers/{answer['id']}")
    plan = page.get_by_role("group", name="Plan of two storeys.ply")
    for number in ("0", "1"):
        page.get_by_label("Floor of the plan").select_option(number)
        expect(plan.locator("g.marker")).to_have_count(1)


def _figures(page: Page, name: str) -> list[float]:
    shown = page.get_by_role("region", name="Measurement").locator(f"dt:text-is('{name}') + dd").inner_text()
    return [float(value) for value in re.findall(r"-?[0-9]+[.][0-9]+", shown)]


def _num_stored_points(service: RunningService, map_id: str) -> int:
    points = service.http.get(f"/maps/{map_id}/points?max_points=10000000").content
    header, _, body = points.partition(b"end_header\n")
    assert b"property float x" in header
    return len(body) // struct.calcsize("<fffBBB")


def test_a_scan_that_lies_on_its_side_in_feet_is_asked_about_and_two_clicks_mend_it(
    page: Page, service: RunningService
) -> None:
    room = scan_scene(build_scene(SceneSpec("bare", 207)), num_points=40_000, seed=207)
    turned = room.positions[:, [0, 2, 1]].astype(np.float64) * [1, 1, -1] / 0.3048  # y up, as models have it
    scan = encode_ply(replace(room, positions=turned.astype(np.float32)))
    map_id = service.register(scan, '{"starts": {"method": "grid", "spacing_m": 4.0}}', "on its side.ply")
    page.goto(f"{service.http.base_url}/#/maps/{map_id}")
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
