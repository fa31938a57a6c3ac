"""Rigs: images and what is known of their cameras."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.errors import PanoramaShapeError
from panoloc.core.geometry.pose import Pose
from tests.core.painted_box import rotation_of

PINHOLE = Camera("pinhole", 32, 24, 30.0, 31.0, 15.0, 12.5)
LENS = Camera("opencv", 32, 24, 30.0, 31.0, 15.0, 12.5, (0.1, 0.0, 0.0, 0.0))
FISHEYE = Camera("opencv_fisheye", 32, 24, 10.0, 10.0, 16.0, 12.0)


def photo_of(camera: Camera) -> Photo:
    shape = camera.height_px, camera.width_px
    blank = np.zeros((*shape, 3), np.uint8)
    return Photo(blank, np.ones(shape, bool), camera, hfov_range_deg=(40.0, 90.0), focal_uncertainty=0.02)


def rig_of(*cameras: Camera) -> Rig:
    poses = (Pose(rotation_of(30.0 * k), np.array([k, 2.0 * k, 1.0])) for k in range(len(cameras)))
    return Rig(tuple(RigImage(photo_of(camera), pose) for camera, pose in zip(cameras, poses, strict=True)))


def test_an_image_has_the_size_of_its_camera() -> None:
    for shape in ((24, 31), (32, 24)):
        with pytest.raises(PanoramaShapeError, match="camera's 32 x 24 pixels"):
            Photo(np.zeros((*shape, 3), np.uint8), np.ones(shape, bool), PINHOLE)


def test_the_axes_of_a_rig_are_those_of_the_session_from_the_middle_of_its_cameras() -> None:
    middle = rig_of(PINHOLE, LENS, PINHOLE).session_from_rig
    assert middle.position.tolist() == [1.0, 2.0, 1.0]
    np.testing.assert_array_equal(middle.rotation, np.eye(3))


def test_a_longer_focal_length_is_that_of_every_image_and_nothing_else_changes() -> None:
    rig = rig_of(PINHOLE, LENS)
    longer = rig.with_focal_factor(1.5)
    for before, after in zip(rig.images, longer.images, strict=True):
        given, camera = before.photo.camera, after.photo.camera
        assert (camera.fx_px, camera.fy_px) == (45.0, 46.5)
        assert (camera.cx_px, camera.cy_px, camera.distortion) == (given.cx_px, given.cy_px, given.distortion)
        assert (after.photo.hfov_range_deg, after.photo.focal_uncertainty) == ((40.0, 90.0), 0.02)
        assert after.session_from_camera is before.session_from_camera


@pytest.mark.parametrize(
    ("cameras", "expected"), [((PINHOLE, LENS), True), ((PINHOLE, FISHEYE), False), ((FISHEYE,), False)]
)
def test_planes_alone_have_a_focal_length(cameras: tuple[Camera, ...], expected: bool) -> None:
    assert rig_of(*cameras).has_focal_length == expected


@pytest.mark.parametrize("rows", [5, 64])
def test_a_panorama_is_an_image_of_a_camera_that_sees_the_whole_sphere(rows: int) -> None:
    rng = np.random.default_rng(0)
    panorama = Panorama(
        rng.integers(0, 256, (rows, 2 * rows, 3)).astype(np.uint8), rng.uniform(size=(rows, 2 * rows)) < 0.5, ("words",)
    )
    rig = Rig.of_panorama(panorama)
    (photo,) = rig.photos
    assert photo.camera.is_whole_sphere
    assert not rig.has_focal_length
    assert rig.left_out == ("words",)
    np.testing.assert_array_equal(photo.color, panorama.color)
    np.testing.assert_array_equal(photo.valid, panorama.valid)


def test_a_strip_of_a_panorama_may_be_cut_on_either_side_unless_its_horizon_is_known() -> None:
    strip = Camera.from_hfov("equirectangular", 64, 24, 360.0)
    for rig, row in zip(rig_of(strip).cut_on_one_side(), (0, 24), strict=True):
        (camera,) = (photo.camera for photo in rig.photos)
        assert abs(row - camera.cy_px) == pytest.approx(16)  # of 32 rows, a quarter turn from the pole to the horizon
        assert replace(camera, cy_px=strip.cy_px) == strip
    whole, part = Camera.from_hfov("equirectangular", 64, 32, 360.0), Camera.from_hfov("equirectangular", 64, 24, 270.0)
    measured = Rig.of_photo(replace(photo_of(strip), focal_uncertainty=0.0))
    for other in (rig_of(whole), rig_of(part), rig_of(PINHOLE), rig_of(strip, strip), measured):
        assert other.cut_on_one_side() == []
