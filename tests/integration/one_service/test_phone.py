"""The page for phones, in a browser with a camera and sensors: from the link to the place, and what it says where there is none."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.integration.console_page import serious_faults
from tests.integration.phone import Hand, phone_at
from tests.integration.running_service import RunningService
from tests.integration.small_room import room_scene

pytestmark = [pytest.mark.integration, pytest.mark.slow]

# Where one picture shows enough, and where it does not.
SURE = Hand(room_scene(), np.array([1.33, 0.04, 1.26]), yaw_deg=150.0, pitch_deg=4.0)
UNSURE = Hand(room_scene(), np.array([1.07, 0.26, 1.37]), yaw_deg=260.0, pitch_deg=4.0)


def test_one_picture_says_where_somebody_stands_and_the_page_leads_on(service: RunningService, map_id: str) -> None:
    with phone_at(f"{service.http.base_url}/m/{map_id}") as phone:
        expect(phone.page.get_by_role("button", name="Find where I am")).to_be_visible()
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


def test_who_turns_is_found_where_one_picture_shows_too_little(service: RunningService, map_id: str) -> None:
    with phone_at(f"{service.http.base_url}/m/{map_id}", color_scheme="dark") as phone:
        found = phone.find(UNSURE)
        assert found.title == "You are here"
        assert found.num_shots > 1
        assert found.error_m < 0.1


def test_a_map_that_is_not_there_is_said_to_be_so(service: RunningService) -> None:
    with phone_at(f"{service.http.base_url}/m/map_never") as phone:
        expect(phone.page.get_by_role("heading", name="There is no such map")).to_be_visible()
        assert serious_faults(phone.page) == []
