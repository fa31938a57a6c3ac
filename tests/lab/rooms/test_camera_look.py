"""Light and camera changes do to an image what their names say."""

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama
from panoloc.lab.rooms import Scene, View, apply_look, changed_pixels, take_view
from panoloc.lab.rooms.capture.camera_look import DIM, GAMMA_3, WHITE_BALANCE, CameraLook
from panoloc.lab.rooms.capture.intruders import show_hand
from panoloc.lab.rooms.materials.labels import label_number
from panoloc.lab.rooms.scenes.changes import night


@pytest.fixture
def ramp() -> Panorama:
    color = np.zeros((32, 64, 3), np.uint8)
    color[..., 0], color[..., 1], color[..., 2] = 200, 100, np.arange(64)[None] * 4
    return Panorama(color, np.ones((32, 64), np.bool_))


def test_the_light_changes_of_the_paper_have_its_values(ramp: Panorama) -> None:
    assert apply_look(ramp, DIM).color[0, 0, :2].tolist() == [134, 67]
    assert apply_look(ramp, WHITE_BALANCE).color[0, 0, :2].tolist() == [200, 50]
    expected = [round(255 * (value / 255) ** 3) for value in (200, 100)]
    assert apply_look(ramp, GAMMA_3).color[0, 0, :2].tolist() == expected


def test_noise_has_its_deviation_and_repeats_by_seed(ramp: Panorama) -> None:
    look = CameraLook(noise=0.02)
    first, again, other = (apply_look(ramp, look, seed).color for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert 4.5 < (first[..., 1].astype(float) - 100).std() < 5.7


def test_blur_wraps_around_the_seam(ramp: Panorama) -> None:
    blurred = apply_look(ramp, CameraLook(blur_px=2.0)).color[..., 2].astype(int)
    # The blue ramp jumps from 252 to 0 at the seam; both sides must meet in the middle.
    assert 90 < blurred[16, 0] < 130
    assert 120 < blurred[16, -1] < 165


@pytest.mark.slow
def test_a_hand_covers_the_nadir_and_nothing_else(room_view: View) -> None:
    panorama, covered = show_hand(room_view.panorama, seed=3)
    assert covered[-4:].all()
    assert not covered[: covered.shape[0] // 2].any()
    np.testing.assert_array_equal(panorama.color[~covered], room_view.panorama.color[~covered])


@pytest.mark.slow
def test_at_night_windows_are_dark_and_nothing_counts_as_changed(room: Scene, room_view: View) -> None:
    dark = night(room)
    view = take_view(dark, room_view.pose, 512)
    window = room.surface.label[room_view.hits.triangle] == label_number("window")
    assert window.any()
    brightness = [shown.panorama.color.reshape(-1, 3)[window].mean() for shown in (room_view, view)]
    assert brightness[1] < 0.4 * brightness[0]
    assert not changed_pixels(view, dark, room).any()
    # The camera exposes anew, so the rest of the room does not turn dark as a whole.
    rest = [shown.panorama.color.reshape(-1, 3)[~window].mean() for shown in (room_view, view)]
    assert rest[1] > 0.6 * rest[0]
