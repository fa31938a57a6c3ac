"""The page for phones, in a browser with a camera and sensors: from the link to the place, and what it says where there is none."""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.integration.ar_phone import ArPhone, ar_phone_at
from tests.integration.console_page import serious_faults
from tests.integration.phone import CameraBrowser, Hand, camera_browser, phone_at
from tests.integration.running_service import RunningService
from tests.integration.small_room import room_scene

pytestmark = [pytest.mark.integration, pytest.mark.slow]

# Where one picture shows enough, and where it does not.
SURE = Hand(room_scene(), np.array([1.33, 0.04, 1.26]), yaw_deg=150.0, pitch_deg=4.0)
UNSURE = Hand(room_scene(), np.array([1.07, 0.26, 1.37]), yaw_deg=260.0, pitch_deg=4.0)


@pytest.fixture(scope="module")
def through() -> Iterator[CameraBrowser]:
    with camera_browser() as started:
        yield started


def test_one_picture_says_where_somebody_stands_and_the_page_leads_on(
    service: RunningService, through: CameraBrowser, map_id: str
) -> None:
    with phone_at(f"{service.http.base_url}/m/{map_id}", through) as phone:
        expect(phone.page.get_by_role("button", name="Find where I am")).to_be_visible()
        assert phone.page.get_by_role("button", name="Look around with AR").count() == 0
        assert serious_faults(phone.page) == []
        found = phone.find(SURE)
        assert (found.title, found.num_shots) == ("You are here", 1)
        assert found.error_m < 0.1
        assert serious_faults(phone.page) == []
        plan = phone.page.get_by_role("application", name=re.compile("^Plan of"))
        box = plan.bounding_box()
        assert box is not None
        plan.click(position={"x": box["width"] / 2, "y": box["height"] / 2})
        way = phone.page.get_by_text(re.compile(r"\d m (straight|ahead|to your|behind)"))
        expect(way).to_contain_text(re.compile(r"^1\.\d m"))
        for _ in range(10):  # each a fiftieth of the plan further
            plan.press("ArrowLeft")
        expect(way).to_contain_text(re.compile(r"^2\.\d m"))
        before = way.inner_text()
        # Who turns around has it on the other side.
        phone.hold(SURE, 180.0)
        expect(way).not_to_have_text(before)
        learnt = phone.page.evaluate("JSON.parse(localStorage.getItem('panoloc-lenses'))")
        assert [lens["deg"] for lens in learnt.values()] == [pytest.approx(SURE.longer_hfov_deg, abs=4)]


def test_who_turns_is_found_where_one_picture_shows_too_little(
    service: RunningService, through: CameraBrowser, map_id: str
) -> None:
    with phone_at(f"{service.http.base_url}/m/{map_id}", through, color_scheme="dark") as phone:
        found = phone.find(UNSURE)
        assert found.title == "You are here"
        assert found.num_shots > 1
        assert found.error_m < 0.1


def test_a_map_that_is_not_there_is_said_to_be_so(service: RunningService, through: CameraBrowser) -> None:
    with phone_at(f"{service.http.base_url}/m/map_never", through) as phone:
        expect(phone.page.get_by_role("heading", name="There is no such map")).to_be_visible()
        assert serious_faults(phone.page) == []


def start_ar(phone: ArPhone) -> None:
    """Start AR, and turn until the page says that it found the place."""
    phone.page.get_by_role("button", name="Look around with AR").click()
    expect(phone.page.get_by_text("Looking for this place")).to_be_visible()
    assert phone.page.get_by_role("button", name="Leave a note here").count() == 0
    found = phone.page.get_by_text("Found. Notes stay")
    for turned_deg in range(0, 270, 45):
        if not found.is_visible():
            phone.hold(SURE, turned_deg)
            phone.page.wait_for_timeout(350)  # longer than the tracker's pause between frames
    expect(found).to_be_visible()


def test_a_note_that_was_left_with_ar_is_at_its_place_after_a_reload(
    service: RunningService, through: CameraBrowser, map_id: str
) -> None:
    with ar_phone_at(f"{service.http.base_url}/m/{map_id}", through.chromium) as phone:
        page = phone.page
        note = page.locator("p", has_text="The key is here")
        start_ar(phone)
        phone.hold(SURE, 0.0)
        page.get_by_role("button", name="Leave a note here").click()
        page.get_by_label("Text of the note").fill("The key is here")
        assert serious_faults(page) == []
        page.get_by_role("button", name="Leave it").click()
        expect(note).to_contain_text(re.compile("9[5-9] cm|10[0-5] cm|1.0 m"))  # as exact as the pose has to be
        left_at = SURE.pose(0.0).position + SURE.pose(0.0).rotation[:, 0]
        assert serious_faults(page) == []
        page.evaluate("endSession()")
        expect(page.get_by_text("AR has ended")).to_be_visible()

        phone.reload()
        start_ar(phone)
        elsewhere = replace(SURE, stand=SURE.stand + np.array([0.15, -0.1, 0.05]))
        phone.hold(elsewhere, 12.0)
        expect(note).to_be_visible()
        page.wait_for_timeout(500)  # until corrections are blended
        camera = elsewhere.pose(12.0)
        to_note = left_at - camera.position
        direction = phone.seen_direction(note, camera)
        shown_m = np.linalg.norm(to_note - (to_note @ direction) * direction)
        kept = page.evaluate(
            "JSON.parse(Object.entries(localStorage).find(([name]) => name.startsWith('panoloc-notes'))[1])"
        )
        kept_m = np.linalg.norm(np.array([kept[0]["position_m"][axis] for axis in "xyz"]) - left_at)
        print(f"kept {kept_m:.3f} m and shown {shown_m:.3f} m from where it was left")
        assert max(kept_m, shown_m) < 0.05

        page.get_by_text("1 note in this room").click()
        page.get_by_role("button", name="Delete the note").click()
        expect(note).to_have_count(0)


def test_who_refuses_ar_reads_what_to_do(service: RunningService, through: CameraBrowser, map_id: str) -> None:
    with ar_phone_at(f"{service.http.base_url}/m/{map_id}", through.chromium) as phone:
        phone.page.evaluate(
            "() => { navigator.xr.requestSession = async () => { throw new DOMException('', 'NotAllowedError') } }"
        )
        phone.page.get_by_role("button", name="Look around with AR").click()
        expect(phone.page.get_by_role("alert")).to_contain_text("may not use the camera for AR")
