"""Photos whose field of view nobody knows."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.errors import OptionsError
from panoloc.core.fast.field_of_view import searched_range_deg
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.panorama.session import Photo, Session, SessionImage
from tests.core.built_maps import AS_LABELS, LABELLED, map_of
from tests.core.painted_box import PaintedBox
from tests.core.panorama.painted_photos import photo_of

WIDTH_DEG = 84.0


def of_unknown_field_of_view(box: PaintedBox, pose: Pose, bounds_deg: tuple[float, float]) -> Photo:
    """Return a photo 84 degrees wide, taken for one of 70."""
    photo = photo_of(box, Camera.from_hfov("pinhole", 640, 480, WIDTH_DEG), pose)
    return replace(photo, camera=Camera.from_hfov("pinhole", 640, 480, 70.0), hfov_range_deg=bounds_deg)


@pytest.mark.slow
def test_a_photo_is_found_although_nobody_knows_how_wide_it_is(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose
) -> None:
    found = localizer.localize(of_unknown_field_of_view(box, box_pose, (60.0, 100.0)), [box_index])
    assert found.status == "localized"
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=2.5)
    assert found.best is not None
    error = pose_error(found.best.pose, box_pose)
    assert error.position_m < 0.15
    assert error.orientation_deg < 3
    # What the focal length leaves open: some percent of the metres to the walls.
    assert found.accuracy_position_m is not None
    assert found.accuracy_position_m > 0.04


@pytest.mark.slow
def test_the_boundaries_of_labels_tell_it_too(localizer: Localizer, box_pose: Pose) -> None:
    query = of_unknown_field_of_view(LABELLED, box_pose, (60.0, 100.0))
    found = localizer.localize(query, [map_of(LABELLED, AS_LABELS)])
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=4.0)
    assert found.best is not None
    assert pose_error(found.best.pose, box_pose).position_m < 0.15


@pytest.mark.slow
def test_a_photo_that_is_wider_than_its_bounds_is_not_localized_and_the_bound_is_named(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose
) -> None:
    found = localizer.localize(of_unknown_field_of_view(box, box_pose, (60.0, 76.0)), [box_index])
    assert found.status == "not_localized"
    assert any("76 degrees wide, a bound of hfov_range_deg" in words for words in found.warnings)


@pytest.mark.slow
def test_the_radius_tells_what_the_focal_length_leaves_open(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose
) -> None:
    known = photo_of(box, Camera.from_hfov("pinhole", 640, 480, 100.0), box_pose)
    sharp, blurred = (
        localizer.localize(replace(known, focal_uncertainty=share), [box_index]).accuracy_position_m
        for share in (0.0, 0.03)
    )
    assert sharp is not None
    assert blurred is not None
    walls_m = float(np.sqrt(blurred**2 - sharp**2)) / 0.03
    assert 0.5 < walls_m < 6  # metres to the walls of the box


@pytest.mark.slow
def test_a_focal_length_that_may_be_anything_is_no_answer(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose
) -> None:
    known = photo_of(box, Camera.from_hfov("pinhole", 640, 480, 100.0), box_pose)
    found = localizer.localize(replace(known, focal_uncertainty=0.3), [box_index])
    assert found.status == "not_localized"
    assert any("field of view is not known well enough" in words for words in found.warnings)


def test_the_poses_of_several_photos_say_nothing_where_one_has_no_scale(box: PaintedBox, box_pose: Pose) -> None:
    photo = of_unknown_field_of_view(box, box_pose, (60.0, 100.0))
    image = SessionImage(photo, Pose(np.eye(3), np.zeros(3)))
    assert searched_range_deg(Session((image,))) == (60.0, 100.0)
    with pytest.raises(OptionsError, match="hfov_range_deg: expected a single photo"):
        searched_range_deg(Session((image, image)))
