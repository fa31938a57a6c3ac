"""From pixels to directions: held against the projection of each camera model, which is held against OpenCV."""

import math

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image
from panoloc.core.survey.rays import directions_of

CAMERAS = {
    "pinhole": Camera.from_hfov("pinhole", 640, 480, 69.0),
    "mild lens": Camera("opencv", 640, 480, 470.0, 468.0, 322.0, 239.0, (0.11, -0.23, 0.0012, -0.0007)),
    "barrel": Camera("opencv", 640, 480, 520.0, 520.0, 320.0, 240.0, (-0.28, 0.07, 0.0005, -0.0004, -0.008)),
    "rational": Camera(
        "opencv", 640, 480, 470.0, 470.0, 320.0, 240.0, (0.31, -0.12, 0.0005, 0.0002, 0.02, 0.28, -0.05, 0.01)
    ),
    "fisheye": Camera("opencv_fisheye", 640, 640, 300.0, 301.0, 318.0, 322.0, (0.03, -0.012, 0.004, -0.0008)),
    "sweep": Camera.from_hfov("cylindrical", 1600, 400, 300.0),
    "part of a sphere": Camera("equirectangular", 500, 300, 160.0, 170.0, 200.0, 160.0),
    "full sphere": Camera.from_hfov("equirectangular", 512, 256, 360.0),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_direction_of_a_pixel_is_projected_to_that_pixel(name: str) -> None:
    camera = CAMERAS[name]
    u, v = np.meshgrid(np.arange(0, camera.width_px, 7) + 0.5, np.arange(0, camera.height_px, 7) + 0.5)
    directions, shown = directions_of(camera, u, v)
    assert shown.all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    again_u, again_v, seen = project_to_image(camera, directions)
    assert seen.all()
    np.testing.assert_allclose(again_u, u, atol=1e-6)
    np.testing.assert_allclose(again_v, v, atol=1e-6)


def test_corners_that_a_fisheye_does_not_fill_show_nothing() -> None:
    camera = Camera("opencv_fisheye", 1000, 1000, 140.0, 140.0, 500.0, 500.0)  # pi * 140 px = 440 px is a full turn
    _, shown = directions_of(camera, np.array([500.0, 5.0, 930.0]), np.array([500.0, 5.0, 500.0]))
    assert shown.tolist() == [True, False, True]


def test_a_distortion_that_folds_has_no_direction_beyond_the_fold() -> None:
    # r (1 - r²/3) grows up to r = 1, where it is 2/3, and falls again.
    camera = Camera("opencv", 4000, 4000, 1000.0, 1000.0, 2000.0, 2000.0, (-1 / 3, 0.0, 0.0, 0.0))
    directions, shown = directions_of(camera, np.array([2000.0 + 600, 2000.0 + 700]), np.array([2000.0, 2000.0]))
    assert shown.tolist() == [True, False]
    radius = math.hypot(*directions[0, 1:]) / directions[0, 0]
    assert radius * (1 - radius**2 / 3) == pytest.approx(0.6)
