"""Poses from clicked pixels and points of a scan: made-up cameras in a room of 6 x 5 x 2.6 m, clicks 3 px off."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.survey.resection import resect, residuals_px

Array = NDArray[np.float64]
SPHERE = Camera("equirectangular", 2048, 1024, 1024 / math.pi, 1024 / math.pi, 1024, 512)
PHOTO = Camera.from_hfov("pinhole", 1600, 1200, 69)
FISHEYE = Camera("opencv_fisheye", 1600, 1200, 500, 500, 800, 600, (0.01, -0.01, 0.001, 0.0))
DISTORTED = Camera("opencv", 1600, 1200, 1100, 1100, 800, 600, (-0.2, 0.05, 0.001, -0.001))
CORNERS = np.array([[0.1, 0.2, 2.5], [5.9, 0.3, 0.4], [5.8, 4.9, 2.4], [0.3, 4.7, 0.9], [3.0, 4.95, 1.8]])
POSITION = np.array([2.1, 1.9, 1.6])


def turned(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def seen(camera: Camera, pose: Pose, points: Array) -> Array:
    u, v, shown = project_to_image(camera, (points - pose.position) @ pose.rotation)
    assert shown.all()
    return np.stack([u, v], axis=1)


@pytest.mark.parametrize("yaw", [0.0, 1.0, 3.1, -2.0])
def test_four_clicks_in_a_panorama_find_it_within_its_radius(yaw: float) -> None:
    pose = Pose(turned(yaw), POSITION)
    pixels = seen(SPHERE, pose, CORNERS[:4])
    exact = resect(SPHERE, pixels, CORNERS[:4])
    assert len(exact) == 1
    assert pose_error(exact[0].pose, pose).within(1e-6, 1e-4)
    noisy = resect(SPHERE, pixels + np.random.default_rng(1).normal(0, 3, pixels.shape), CORNERS[:4])[0]
    error = pose_error(noisy.pose, pose)
    assert error.position_m < 2.5 * noisy.radius_m < 0.3
    assert noisy.residuals_px == pytest.approx(residuals_px(SPHERE, noisy.pose, pixels, CORNERS[:4]), abs=12)


def test_three_points_leave_several_poses_and_the_level_one_comes_first() -> None:
    pose = Pose(turned(0.9), POSITION)
    points = np.array([[5.9, 3.5, 2.4], [5.9, 4.9, 0.4], [3.0, 4.9, 1.9]])
    found = resect(PHOTO, seen(PHOTO, pose, points), points)
    assert pose_error(found[0].pose, pose).within(1e-4, 0.01)
    assert all(np.allclose(each.residuals_px, 0, atol=0.1) for each in found)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (CORNERS[:2], "expected 3 to 100 pairs, got 2"),
        (np.array([[0.0, 0, 1], [1, 0, 1], [2, 0.001, 1], [3, 0, 1]]), "in one line"),
        (CORNERS[[0, 1, 2, 2]], "^pairs: .*pairs 3 and 4 at nearly the same place"),
        (np.array([[5.9, 1.9, 1.5], [5.9, 2.0, 1.6], [5.9, 1.8, 1.7]]), "leave .* on one wall"),
    ],
)
def test_points_that_fix_no_pose_are_refused_with_what_to_click(points: Array, words: str) -> None:
    pixels = seen(SPHERE, Pose(np.eye(3), POSITION), points)
    with pytest.raises(OptionsError, match=words):
        resect(SPHERE, pixels, points)


def test_a_wrong_point_is_named() -> None:
    pixels = seen(SPHERE, Pose(np.eye(3), POSITION), CORNERS)
    wrong = CORNERS.copy()
    wrong[4] = [0.5, 0.5, 0.1]
    with pytest.raises(OptionsError, match="pair 5 does not fit the others: click it again"):
        resect(SPHERE, pixels, wrong)


def test_a_point_that_is_a_little_wrong_is_named_beside_the_pose() -> None:
    points = np.array([[5.9, 3.5, 2.0], [5.9, 4.9, 0.4], [3.0, 4.9, 1.9], [4.5, 4.9, 1.0], [4.5, 3.5, 0.4]])
    clicked = seen(PHOTO, Pose(turned(0.7), POSITION), points) + np.random.default_rng(1).normal(0, 3, (5, 2))
    assert resect(PHOTO, clicked, points)[0].suspect is None
    clicked[2] += [60, 30]
    assert resect(PHOTO, clicked, points)[0].suspect == 2


def test_of_inexact_points_that_leave_the_camera_open_the_worst_are_named() -> None:
    wall = np.array([[5.9, y, z] for y, z in ((3.1, 0.5), (4.9, 2.2), (3.9, 1.2), (4.6, 0.4), (3.2, 2.3), (4.2, 2.0))])
    pixels = seen(PHOTO, Pose(turned(0.7), POSITION), wall)
    wrong = wall.copy()
    wrong[[2, 5], 2] += [0.15, -0.15]
    with pytest.raises(OptionsError, match=r"within 0.5 m.*pair 3 \(\d+ px off\) and pair 6 \(\d+ px off\) again"):
        resect(PHOTO, pixels, wrong)


def test_of_four_points_none_is_named() -> None:
    pixels = seen(SPHERE, Pose(np.eye(3), POSITION), CORNERS[:4])
    wrong = CORNERS[:4].copy()
    wrong[3] = [0.5, 0.5, 0.1]
    with pytest.raises(OptionsError, match="check which point of the scan each of them shows"):
        resect(SPHERE, pixels, wrong)
