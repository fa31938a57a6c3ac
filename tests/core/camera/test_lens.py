"""Projection of each camera model, against OpenCV's own numbers and closed forms.

The numbers of `opencv` and `opencv_fisheye` were computed with cv2.projectPoints and cv2.fisheye.projectPoints, OpenCV 5.0; as there the
centre of the top-left pixel is (0, 0), principal points are half a pixel further from the corner here, and so are the pixels.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image, share_with_direction

# x right, y down, z forward.
POINTS = np.array([[0.3, -0.2, 1.0], [-0.9, 0.55, 1.2], [0.05, 0.6, 0.8]])
BY_DISTORTION = {
    (0.11, -0.23, 0.0012, -0.0007): [
        (1400.56675758, 429.97970058),
        (-72.39299449, 1354.28426385),
        (1050.67694451, 1799.14376891),
    ],
    (0.11, -0.23, 0.0012, -0.0007, 0.08): [
        (1400.64322373, 429.92877588),
        (-112.51584075, 1378.77841950),
        (1051.99453975, 1814.93855765),
    ],
    (0.31, -0.12, 0.0005, 0.0002, 0.02, 0.28, -0.05, 0.01): [
        (1397.71357903, 431.86101908),
        (-113.32107670, 1379.10211595),
        (1052.08310692, 1806.56390796),
    ],
}
FISHEYE_POINTS = np.array([[0.3, -0.2, 1.0], [-0.9, 0.55, 1.2], [2.0, 0.6, 0.8], [1.4, 0.1, 0.05]])
FISHEYE_PIXELS = [
    (976.23827514, 482.12259630),
    (419.85690983, 833.07133725),
    (1522.97263286, 817.60291047),
    (1763.72451, 669.06316159),
]


def flu(points: np.ndarray) -> np.ndarray:
    """Return points of OpenCV's axes in ours."""
    return np.stack((points[..., 2], -points[..., 0], -points[..., 1]), axis=-1)


@pytest.mark.parametrize("distortion", BY_DISTORTION, ids=len)
def test_a_distorted_photo_has_its_pixels_where_opencv_has_them(distortion: tuple[float, ...]) -> None:
    camera = Camera("opencv", 1920, 1440, 1450.2, 1448.7, 962.0, 722.75, distortion)
    u, v, _ = project_to_image(camera, flu(POINTS))
    np.testing.assert_allclose(np.stack((u, v), axis=-1) - 0.5, BY_DISTORTION[distortion], atol=1e-6)


def test_a_fisheye_has_its_pixels_where_opencv_has_them() -> None:
    camera = Camera("opencv_fisheye", 1900, 1400, 610.0, 612.0, 800.5, 600.5, (0.03, -0.012, 0.004, -0.0008))
    u, v, shown = project_to_image(camera, flu(FISHEYE_POINTS))
    np.testing.assert_allclose(np.stack((u, v), axis=-1) - 0.5, FISHEYE_PIXELS, atol=1e-5)
    assert shown.all()


def test_a_pinhole_sees_what_is_in_front_of_it_and_nothing_behind() -> None:
    camera = Camera.from_hfov("pinhole", 200, 100, 90.0)
    assert camera.fx_px == pytest.approx(100.0)
    directions = np.array([[1.0, 0, 0], [1, 0.99, 0], [1, -0.99, 0], [1, 0, 0.49], [-1, 0, 0], [1, 1.01, 0], [0, 1, 0]])
    u, v, shown = project_to_image(camera, directions)
    assert shown.tolist() == [True, True, True, True, False, False, False]
    np.testing.assert_allclose(u[:4], [100, 1, 199, 100])
    np.testing.assert_allclose(v[:4], [50, 50, 50, 1])


def test_a_distortion_that_folds_shows_nothing_beyond_the_fold() -> None:
    # r (1 - r²/3) grows up to r = 1, where it is 2/3, and falls again: two directions would share each pixel.
    camera = Camera("opencv", 4000, 4000, 1000.0, 1000.0, 2000.0, 2000.0, (-1 / 3, 0.0, 0.0, 0.0))
    _, _, shown = project_to_image(camera, np.array([[1.0, 0.9, 0], [1, 1.1, 0], [1, 1.6, 0]]))
    assert shown.tolist() == [True, False, False]
    # Of radius 2/3 in focal lengths, in an image of 4 x 4 focal lengths.
    assert share_with_direction(camera) == pytest.approx(math.pi * (2 / 3) ** 2 / 16, abs=0.01)


def test_a_cylinder_is_even_in_azimuth_and_straight_in_height() -> None:
    camera = Camera.from_hfov("cylindrical", 1800, 400, 180.0)
    azimuth = np.radians([90.0, 45.0, 0.0, -90.0])
    directions = np.stack((np.cos(azimuth), np.sin(azimuth), np.full(4, 0.2)), axis=-1)
    u, v, shown = project_to_image(camera, directions)
    np.testing.assert_allclose(u, [0, 450, 900, 1800], atol=1e-9)
    np.testing.assert_allclose(v, 200 - 0.2 * 1800 / math.pi)
    assert shown.all()


def test_a_full_equirectangular_image_has_the_pixels_of_the_convention() -> None:
    camera = Camera.from_hfov("equirectangular", 2048, 1024, 360.0)
    # The golden point of the specification of frames: azimuth -0.771272, elevation -1.573615 degrees.
    u, v, shown = project_to_image(camera, np.array([4.582885572, -0.061695034, -0.125910922]))
    assert (float(u), float(v)) == pytest.approx((1028.387681, 520.952120), abs=1e-5)
    assert bool(shown)


MODELS = st.sampled_from(["pinhole", "opencv_fisheye", "cylindrical", "equirectangular"])


@given(MODELS, st.floats(30, 150))
def test_the_edges_of_an_image_lie_half_its_field_of_view_from_the_axis(model: str, hfov_deg: float) -> None:
    camera = Camera.from_hfov(model, 640, 480, hfov_deg)  # type: ignore[arg-type]
    half = math.radians(hfov_deg) / 2
    u, _, _ = project_to_image(
        camera, np.array([[math.cos(half), math.sin(half), 0], [math.cos(half), -math.sin(half), 0]])
    )
    np.testing.assert_allclose(u, [0, 640], atol=1e-6)
    assert camera.hfov_deg == pytest.approx(hfov_deg)
