"""What people do in the console, in a browser: from a dropped scan to standing where a photo was taken."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page, expect

from tests.integration.console_page import browser, page_of, picture_of, scene_state, wait_until_drawn
from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS, small_room

pytestmark = [pytest.mark.integration, pytest.mark.slow]

HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    running = RunningService(tmp_path_factory.mktemp("console") / "data")
    running.wait_until_ready()
    yield running
    running.stop()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def room_id(service: RunningService) -> str:
    return service.register(small_room().scan, json.dumps({**json.loads(OPTIONS), "name": HOSTILE, "tags": ["test"]}))


@pytest.fixture
def page(service: RunningService, chromium: Browser) -> Iterator[Page]:
    with page_of(chromium, str(service.http.base_url)) as opened:
        yield opened


def files(folder: Path) -> tuple[Path, Path]:
    """Write scan and panorama of the room into a folder."""
    scan, panorama = folder / "room.ply", folder / "panorama.jpg"
    scan.write_bytes(small_room().scan)
    panorama.write_bytes(small_room().panorama)
    return scan, panorama


def test_a_dropped_scan_becomes_a_map_with_a_picture(page: Page, tmp_path: Path) -> None:
    scan, _ = files(tmp_path)
    page.get_by_label("Choose scans to upload").set_input_files(scan)
    card = page.get_by_role("link", name="room.ply")
    expect(card).to_be_visible(timeout=120_000)
    expect(card.locator("img")).to_be_visible(timeout=120_000)
    expect(card).to_contain_text("points")


def test_a_file_that_is_no_scan_is_refused_with_what_to_do_and_can_be_dismissed(page: Page, tmp_path: Path) -> None:
    wrong = tmp_path / "holiday.ply"
    wrong.write_bytes(b"this is no scan")
    page.get_by_label("Choose scans to upload").set_input_files(wrong)
    note = page.get_by_role("alert").filter(has_text="Request")
    expect(note).to_contain_text("expected")
    page.get_by_role("button", name="Dismiss").click()
    expect(note).to_have_count(0)


def test_the_name_of_a_map_is_text(page: Page, room_id: str) -> None:
    expect(page.get_by_role("link", name=HOSTILE)).to_be_visible()
    assert page.locator("img[src=x]").count() == 0


def test_photo_and_points_meet_where_the_photo_was_taken(
    page: Page, service: RunningService, room_id: str, tmp_path: Path
) -> None:
    _, panorama = files(tmp_path)
    page.goto(f"{service.http.base_url}/#/maps/{room_id}")
    wait_until_drawn(page, _num_stored_points(service, room_id))
    page.get_by_label("Choose photos to localize").set_input_files(panorama)
    page.get_by_role("button", name="Stand here").click()
    expect(page.get_by_role("button", name="Step out")).to_be_visible()
    assert scene_state(page)["isStanding"]
    slider = page.get_by_label("From points to photo")
    slider.fill("0")
    points = picture_of(page, tmp_path, "points")
    slider.fill("1")
    photo = picture_of(page, tmp_path, "photo")
    shift, agreement = best_shift(edges(points), edges(photo))
    assert np.hypot(*shift) <= 4, (shift, agreement)
    assert agreement > 0.3


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


def _num_stored_points(service: RunningService, map_id: str) -> int:
    points = service.http.get(f"/maps/{map_id}/points?max_points=10000000").content
    header, _, body = points.partition(b"end_header\n")
    assert b"property float x" in header
    return len(body) // struct.calcsize("<fffBBB")
