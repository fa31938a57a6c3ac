"""Rigs: images and what is known of their cameras."""

import math
from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.errors import PanoramaShapeError
from panoloc.core.geometry.pose import Pose
from tests.core.found_pose import known
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


STRIP = Camera.from_hfov("equirectangular", 64, 24, 360.0)
SWEEP = Camera.from_hfov("cylindrical", 64, 24, 200.0)


@pytest.mark.parametrize(
    ("cameras", "expected"),
    [
        ((STRIP,), True),
        ((SWEEP,), True),
        ((FISHEYE,), True),
        ((Camera.from_hfov("equirectangular", 64, 24, 270.0),), True),
        ((Camera.from_hfov("equirectangular", 64, 32, 360.0),), False),
        ((Camera.from_hfov("cylindrical", 64, 24, 360.0),), False),
        ((PINHOLE,), False),
        ((STRIP, STRIP), False),
    ],
)
def test_a_field_of_view_alone_leaves_the_extent_of_images_without_a_focal_length_open(
    cameras: tuple[Camera, ...], expected: bool
) -> None:
    assert rig_of(*cameras).has_unsure_extent == expected
    assert not Rig.of_photo(replace(photo_of(cameras[0]), focal_uncertainty=0.0)).has_unsure_extent


@pytest.mark.parametrize(("side", "row"), [(-1, 8.0), (1, 16.0)])
def test_a_strip_shows_as_much_more_above_the_horizon_as_less_below_but_nothing_beyond_a_pole(
    side: int, row: float
) -> None:
    most = side * math.radians(22.5)  # of 32 rows 24 are left
    other = known(rig_of(STRIP).with_other_extent(0.0, most)).photos[0].camera
    assert other.cy_px == pytest.approx(row)
    assert replace(other, cy_px=STRIP.cy_px) == STRIP
    assert rig_of(STRIP).with_other_extent(0.0, 1.2 * most) is None
    assert rig_of(STRIP).with_other_extent(side * 0.1, 0.0) is None  # all around is all around


def test_a_sweep_shows_as_much_more_on_either_side_and_has_its_horizon_elsewhere() -> None:
    def wider(degrees: float, higher: float = 0.0) -> Rig | None:
        return rig_of(SWEEP).with_other_extent(math.radians(degrees), higher)

    for degrees, width in ((10.0, 220.0), (-10.0, 180.0), (79.9, 359.8)):
        assert known(wider(degrees)).photos[0].camera.hfov_deg == pytest.approx(width)
    assert wider(80.1) is wider(-100.1) is None
    both = known(wider(10.0, 0.1)).photos[0].camera
    assert [both.hfov_deg, both.cy_px] == pytest.approx([220.0, SWEEP.cy_px + 0.1 * SWEEP.fy_px])


def test_the_middle_of_a_fisheye_stays_where_it_is() -> None:
    assert rig_of(FISHEYE).with_other_extent(0.0, 0.1) is None
    assert rig_of(FISHEYE).with_other_extent(0.1, 0.0) is not None
