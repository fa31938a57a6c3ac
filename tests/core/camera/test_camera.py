"""What may be said of a camera, and what a photo says of its own."""

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.errors import OptionsError, PanoramaShapeError
from panoloc.core.image.known_camera import known_camera
from tests.core.image.painted_photos import pinhole_rays
from tests.core.image.picture_files import photo_file

GOOD = Camera("opencv", 1920, 1440, 1450.0, 1450.0, 960.0, 720.0, (0.1, -0.2, 0.0, 0.0))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"model": "brown"}, "model"),
        ({"width_px": 0}, "width_px"),
        ({"height_px": 70_000}, "height_px"),
        ({"fx_px": math.nan}, "fx_px"),
        ({"fy_px": 0.0}, "fy_px"),
        ({"fx_px": math.inf}, "fx_px"),
        ({"fx_px": 1.0}, "fx_px"),  # more than 170 degrees, as of a focal length in millimetres
        ({"cx_px": math.nan}, "cx_px"),
        ({"cy_px": 5000.0}, "cy_px"),
        ({"distortion": (0.1,)}, "distortion"),
        ({"distortion": (0.1, math.nan, 0.0, 0.0)}, "distortion"),
        ({"model": "pinhole"}, "distortion"),
    ],
)
def test_numbers_that_describe_no_camera_are_refused_by_name(changes: dict[str, object], named: str) -> None:
    with pytest.raises(OptionsError, match=f"^{named}: expected"):
        replace(GOOD, **changes)  # type: ignore[arg-type]


def test_a_resized_copy_has_its_intrinsics_scaled() -> None:
    half = GOOD.resized(960, 720)
    assert (half.fx_px, half.fy_px, half.cx_px, half.cy_px) == (725.0, 725.0, 480.0, 360.0)
    assert half.distortion == GOOD.distortion


def test_an_image_of_another_shape_is_refused_with_both_shapes() -> None:
    with pytest.raises(OptionsError, match=r"1920 x 1440 px.* got 1440 x 1920"):
        GOOD.resized(1440, 1920)


def camera_of(width: int, height: int, focal_mm: object) -> Camera:
    """Return the camera that a photo tells by its EXIF data."""
    data = photo_file(np.zeros((height, width, 3), np.uint8), focal_mm)
    camera = known_camera(Image.open(io.BytesIO(data)), data)
    assert isinstance(camera, Camera)
    return camera


def test_the_focal_length_in_35_mm_terms_gives_the_field_of_view() -> None:
    # 26 mm on 36 x 24 mm film shows 69.4 degrees across; of a 4:3 image the diagonal counts: 67.3 degrees.
    camera = camera_of(1200, 800, 26)
    assert camera.hfov_deg == pytest.approx(2 * math.degrees(math.atan(18 / 26)), abs=0.01)
    camera = camera_of(1600, 1200, 26)
    assert camera.hfov_deg == pytest.approx(67.3, abs=0.05)


@pytest.mark.parametrize("focal_mm", [None, 0, 1, 60_000])
def test_a_photo_that_does_not_say_its_focal_length_has_no_camera(focal_mm: object) -> None:
    with pytest.raises(PanoramaShapeError, match="without camera data"):
        camera_of(1200, 800, focal_mm)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"model": "brown", "hfov_deg": 60.0}, "model: expected"),
        ({"model": "pinhole"}, "fx_px: expected the intrinsics"),
        ({"model": "pinhole", "fx_px": 700.0}, "width_px: expected"),
        ({"model": "pinhole", "width_px": 640, "hfov_deg": 60.0}, "width_px and height_px: expected both"),
        (
            {"model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": 700.0, "hfov_deg": 60.0},
            "expected either fx_px",
        ),
        ({"model": "pinhole", "width_px": 640, "height_px": 480, "fx_px": math.nan}, "fx_px: expected a positive"),
        ({"model": "pinhole", "hfov_deg": 0.0}, "hfov_deg: expected 1 to 170"),
        ({"model": "pinhole", "hfov_deg": 220.0}, "got 220; send a sweep as cylindrical"),
        ({"model": "cylindrical", "hfov_deg": 400.0}, "hfov_deg: expected 1 to 360"),
        ({"model": "pinhole", "hfov_deg": 60.0, "distortion": (0.1, 0.0, 0.0, 0.0)}, "distortion: expected none"),
    ],
)
def test_a_description_that_is_no_camera_is_refused_before_any_image_is_there(
    wrong: dict[str, object], named: str
) -> None:
    with pytest.raises(OptionsError, match=named):
        CameraDescription(**wrong)  # type: ignore[arg-type]


def test_a_field_of_view_is_that_of_the_image_as_it_is_shown() -> None:
    camera = CameraDescription("pinhole", hfov_deg=60.0).of_image(stored=(640, 480), turned=(480, 640))
    assert (camera.width_px, camera.height_px) == (480, 640)
    assert camera.hfov_deg == pytest.approx(60.0)


def test_intrinsics_of_the_sensor_belong_to_the_image_as_it_is_stored() -> None:
    description = CameraDescription("pinhole", 1920, 1440, fx_px=1450.0)
    assert description.is_as_stored((960, 720))
    camera = description.of_image(stored=(960, 720), turned=(720, 960))
    assert (camera.width_px, camera.fx_px, camera.fy_px, camera.cx_px) == (960, 725.0, 725.0, 480.0)


def test_intrinsics_of_the_upright_picture_belong_to_it() -> None:
    description = CameraDescription("pinhole", 1440, 1920, fx_px=1450.0)
    assert not description.is_as_stored((960, 720))
    assert description.of_image(stored=(960, 720), turned=(720, 960)).width_px == 720


def test_an_equirectangular_image_needs_no_more_than_its_model() -> None:
    camera = CameraDescription("equirectangular").of_image((2048, 512), (2048, 512))
    assert camera.hfov_deg == pytest.approx(360.0)
    assert camera.fy_px == pytest.approx(2048 / (2 * math.pi))


@pytest.mark.parametrize("hfov_deg", [20.0, 60.0, 90.0, 130.0])
def test_a_field_of_view_in_whole_degrees_is_known_no_better_than_they_say(hfov_deg: float) -> None:
    # Numbers that are rounded to a whole one are off by less than 0.34 in 68 of 100 cases.
    narrow, wide = (Camera.from_hfov("pinhole", 640, 480, hfov_deg + off).fx_px for off in (-0.34, 0.34))
    share = math.log(narrow / wide) / 2
    assert CameraDescription("pinhole", hfov_deg=hfov_deg).focal_uncertainty == pytest.approx(share, rel=0.3)


def test_intrinsics_are_measured_and_bounds_are_no_measurement() -> None:
    intrinsics = CameraDescription("pinhole", 640, 480, fx_px=500.0)
    bounds, sphere = CameraDescription("pinhole", hfov_range_deg=(40.0, 90.0)), CameraDescription("equirectangular")
    assert [each.focal_uncertainty for each in (intrinsics, bounds, sphere)] == [0.0] * 3


@settings(max_examples=20, deadline=None)
@given(st.floats(20, 120), st.integers(20, 200), st.integers(20, 200), st.floats(0.5, 2.0))
def test_the_solid_angle_is_that_of_all_pixels_together(
    hfov_deg: float, width_px: int, height_px: int, factor: float
) -> None:
    camera = Camera.from_hfov("pinhole", width_px, height_px, hfov_deg)
    longer = replace(camera, fx_px=factor * camera.fx_px, fy_px=factor * camera.fy_px)
    # A pixel as far ahead as the focal length is seen under its area, times the cosine to the axis, over the square of its distance.
    of_pixels = pinhole_rays(longer)[..., 0] ** 3 / longer.fx_px**2
    assert camera.solid_angle(factor) == pytest.approx(of_pixels.sum(), rel=1e-3)
