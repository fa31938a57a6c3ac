"""Photos that contradict the focal length that they are said to have."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.panorama.session import Photo, Session, SessionImage
from panoloc.core.results import Localization
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import photo_of

pytestmark = pytest.mark.slow

TRUE_DEG, SAID_DEG = 84.0, 100.0


def said_to_be(photo: Photo, hfov_deg: float) -> Photo:
    camera = photo.camera
    return replace(photo, camera=Camera.from_hfov("pinhole", camera.width_px, camera.height_px, hfov_deg))


@pytest.fixture(scope="module")
def taken(box: PaintedBox, box_pose: Pose) -> Photo:
    return photo_of(box, Camera.from_hfov("pinhole", 640, 480, TRUE_DEG), box_pose)


def error_m(found: Localization, truth: Pose) -> float:
    assert found.best is not None
    return pose_error(found.best.pose, truth).position_m


def test_a_photo_that_says_how_wide_it_is_is_localized_as_that_and_the_answer_says_so(
    localizer: Localizer, box_index: MapIndex, box_pose: Pose, taken: Photo
) -> None:
    found = localizer.localize(said_to_be(taken, SAID_DEG), [box_index])
    assert found.status == "localized"
    assert error_m(found, box_pose) < 0.05
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(TRUE_DEG, abs=2.0)
    (words,) = found.warnings
    assert f"not {SAID_DEG:.1f} as given" in words
    assert "hfov_deg" in words


def test_one_that_is_as_wide_as_it_is_said_to_be_is_left_alone(
    localizer: Localizer, box_index: MapIndex, box_pose: Pose, taken: Photo
) -> None:
    found = localizer.localize(taken, [box_index])
    assert found.found_cameras == ()
    assert found.warnings == ()
    assert error_m(found, box_pose) < 0.05


def test_so_are_the_images_of_a_session(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose
) -> None:
    camera = Camera.from_hfov("pinhole", 320, 240, 66.0)
    turns = [Pose(rotation_of(90.0 * k), np.zeros(3)) for k in range(3)]
    images = tuple(SessionImage(said_to_be(photo_of(box, camera, box_pose.after(turn)), 76.0), turn) for turn in turns)
    found = localizer.localize(Session(images), [box_index])
    assert found.status == "localized"
    assert error_m(found, box_pose) < 0.05
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([66.0] * 3, abs=2.0)
    assert any("images of which the first is 6" in words for words in found.warnings)
