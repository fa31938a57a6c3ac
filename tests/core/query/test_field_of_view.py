"""Photos whose field of view nobody knows, and photos that contradict the one that they are said to have."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Photo, Rig, RigImage
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.query.field_of_view import searched_range_deg
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, POSE, SYMMETRIC, TWIN, localized, map_of
from tests.core.found_pose import assert_found, best_of, known
from tests.core.image.painted_photos import photo_of
from tests.core.painted_box import PaintedBox, rotation_of

WIDTH_DEG = 84.0
TAKEN = Camera.from_hfov("pinhole", 640, 480, WIDTH_DEG)
KNOWN = photo_of(Camera.from_hfov("pinhole", 640, 480, 100.0))


def said_to_be(photo: Photo, hfov_deg: float) -> Photo:
    camera = photo.camera
    return replace(photo, camera=Camera.from_hfov("pinhole", camera.width_px, camera.height_px, hfov_deg))


def of_unknown_field_of_view(bounds_deg: tuple[float, float], box: PaintedBox = BOX) -> Photo:
    """Return a photo 84 degrees wide, taken for one of 70."""
    return replace(said_to_be(photo_of(TAKEN, POSE, box), 70.0), hfov_range_deg=bounds_deg)


@pytest.mark.slow
def test_a_photo_is_found_although_nobody_knows_how_wide_it_is() -> None:
    found = localized(of_unknown_field_of_view((70.0, 96.0)))
    assert found.status == "localized"
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=2.5)
    assert_found(found, POSE, 0.15, 3.0)
    # What the focal length leaves open: some percent of the metres to the walls.
    assert known(found.accuracy_position_m) > 0.04


@pytest.mark.slow
def test_the_boundaries_of_labels_tell_it_too() -> None:
    found = localized(of_unknown_field_of_view((74.0, 92.0), LABELLED), map_of(LABELLED, AS_LABELS))
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=4.0)
    assert_found(found, POSE, 0.15)


@pytest.mark.slow
def test_a_photo_that_is_wider_than_its_bounds_is_not_localized_and_the_bound_is_named() -> None:
    found = localized(of_unknown_field_of_view((70.0, 76.0)))
    assert found.status == "not_localized"
    assert any("76 degrees wide, a bound of hfov_range_deg" in words for words in found.warnings)


@pytest.mark.slow
def test_the_radius_tells_what_the_focal_length_leaves_open() -> None:
    sharp, blurred = (
        localized(replace(KNOWN, focal_uncertainty=share)).accuracy_position_m or np.nan for share in (0.0, 0.03)
    )
    walls_m = float(np.sqrt(blurred**2 - sharp**2)) / 0.03
    assert 0.5 < walls_m < 6  # metres to the walls of the box


@pytest.mark.slow
def test_a_focal_length_that_may_be_anything_is_no_answer() -> None:
    found = localized(replace(KNOWN, focal_uncertainty=0.3))
    assert found.status == "not_localized"
    (words,) = found.warnings
    assert "field of view" in words
    assert "not known well enough" in words


def test_the_poses_of_several_photos_say_nothing_where_one_has_no_scale() -> None:
    image = RigImage(of_unknown_field_of_view((60.0, 100.0)), Pose(np.eye(3), np.zeros(3)))
    assert searched_range_deg(Rig((image,))) == (60.0, 100.0)
    with pytest.raises(OptionsError, match="hfov_range_deg: expected a single photo"):
        searched_range_deg(Rig((image, image)))


# Photos of a known field of view.


@pytest.mark.slow
def test_a_photo_that_says_how_wide_it_is_is_localized_as_that_and_the_answer_says_so() -> None:
    found = localized(said_to_be(photo_of(TAKEN), 100.0))
    assert found.status == "localized"
    # Two degrees more are a focal length 3.5 % shorter, and as much nearer to walls that are two metres away.
    assert_found(found, POSE, 0.08)
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=2.0)
    (words,) = found.warnings
    assert "not 100.0 as given" in words
    assert "hfov_deg" in words


@pytest.mark.slow
def test_a_room_that_looks_the_same_from_two_sides_tells_it_as_well() -> None:
    found = localized(said_to_be(photo_of(TAKEN, POSE, SYMMETRIC), 100.0), SYMMETRIC, top_k=2)
    assert found.status == "ambiguous"
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([WIDTH_DEG], abs=4.0)
    (other,) = found.alternatives
    for side in (POSE, TWIN):
        assert any(pose_error(each.pose, side).within(0.15, 5.0) for each in (best_of(found), other))


@pytest.mark.slow
def test_one_that_is_as_wide_as_it_is_said_to_be_is_left_alone() -> None:
    found = localized(photo_of(TAKEN))
    assert (found.found_cameras, found.warnings) == ((), ())
    assert_found(found, POSE)


@pytest.mark.slow
def test_the_images_of_a_session_say_it_too() -> None:
    camera = Camera.from_hfov("pinhole", 320, 240, 66.0)
    turns = [Pose(rotation_of(90.0 * k), np.zeros(3)) for k in range(3)]
    images = tuple(RigImage(said_to_be(photo_of(camera, POSE.after(turn)), 76.0), turn) for turn in turns)
    found = localized(Rig(images))
    assert found.status == "localized"
    assert_found(found, POSE)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([66.0] * 3, abs=2.0)
    assert any("images of which the first is 6" in words for words in found.warnings)
