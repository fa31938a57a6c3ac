"""Every row of the project's conventions, one test each."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from panoloc.core.geometry.pose import FRAMES, Pose
from panoloc.core.geometry.projection import pixel_directions, project, unproject
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan
from tests.core.painted_box import rotation_of

H, W = 64, 128


def looking_along(x: float, y: float, z: float) -> tuple[float, float]:
    """Return the image position (u, v) of a direction in the camera frame."""
    u, v = project(torch.tensor([x, y, z], dtype=torch.float64), H, W)
    return float(u), float(v)


# Frames and poses.


def test_the_centre_of_the_image_looks_forward_along_x() -> None:
    assert looking_along(1, 0, 0) == pytest.approx((W / 2, H / 2))


def test_the_left_edge_looks_backwards() -> None:
    assert looking_along(-1, 0, 0) == pytest.approx((0, H / 2))
    left = pixel_directions(H, W)[H // 2, 0]
    assert float(left[0]) < -0.99


def test_left_of_the_centre_is_y_and_right_is_minus_y() -> None:
    assert looking_along(0, 1, 0) == pytest.approx((W / 4, H / 2))
    assert looking_along(0, -1, 0) == pytest.approx((3 * W / 4, H / 2))


def test_the_top_row_looks_up_and_the_bottom_row_down() -> None:
    assert looking_along(0, 0, 1)[1] == pytest.approx(0)
    assert looking_along(0, 0, -1)[1] == pytest.approx(H)


def test_columns_run_clockwise_seen_from_above() -> None:
    x, y, _ = pixel_directions(H, W)[H // 2].double().numpy().T
    assert (x[:-1] * y[1:] - y[:-1] * x[1:] < 0).all()


def test_pixel_centres_lie_at_half_integers() -> None:
    directions = pixel_directions(H, W).double()
    column, row = 17, 40
    azimuth, elevation = math.pi - 2 * math.pi * (column + 0.5) / W, math.pi / 2 - math.pi * (row + 0.5) / H
    expected = [
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    ]
    assert directions[row, column].tolist() == pytest.approx(expected, abs=1e-6)


def test_the_mapping_is_colmaps_equirectangular_up_to_the_axes() -> None:
    rng = np.random.default_rng(0)
    for x, y, z in rng.normal(size=(50, 3)):
        x_cv, y_cv, z_cv = -y, -z, x
        longitude, latitude = math.atan2(x_cv, z_cv), math.atan2(-y_cv, math.hypot(x_cv, z_cv))
        expected = (longitude / (2 * math.pi) + 0.5) * W, (0.5 - latitude / math.pi) * H
        assert looking_along(x, y, z) == pytest.approx(expected)


def test_the_heading_of_a_pose_is_the_azimuth_of_the_image_centre() -> None:
    pose = Pose(rotation_of(37.0, 10.0, -20.0), np.zeros(3))
    forward = pose.rotation @ unproject(torch.tensor(W / 2), torch.tensor(H / 2), H, W).double().numpy()
    assert math.degrees(math.atan2(forward[1], forward[0])) == pytest.approx(37.0, abs=1e-4)
    assert math.degrees(pose.yaw_pitch_roll[0]) == pytest.approx(37.0)


def test_map_from_camera_maps_camera_coordinates_to_map_coordinates() -> None:
    pose = Pose(rotation_of(90.0), np.array([10.0, 20.0, 1.5]))
    ahead = pose.matrix @ [2.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(ahead, [10.0, 22.0, 1.5, 1.0], atol=1e-12)


def test_the_position_is_the_camera_centre_not_a_translation() -> None:
    pose = Pose(rotation_of(50.0, 20.0), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(pose.matrix @ [0, 0, 0, 1], [1, 2, 3, 1])


def test_quaternions_are_written_x_y_z_w() -> None:
    quarter = Pose(rotation_of(90.0), np.zeros(3)).quaternion_xyzw
    np.testing.assert_allclose(quarter, [0, 0, math.sqrt(0.5), math.sqrt(0.5)], atol=1e-12)


def test_yaw_pitch_and_roll_are_rz_ry_rx() -> None:
    pose = Pose(rotation_of(100.0, -30.0, 15.0), np.zeros(3))
    assert np.degrees(pose.yaw_pitch_roll).tolist() == pytest.approx([100.0, -30.0, 15.0])


def test_frames_are_named_and_each_camera_looks_forward_along_its_own_axis() -> None:
    assert FRAMES == ("ros", "opencv", "webxr", "unity")
    pose = Pose(np.eye(3), np.array([1.0, 2.0, 3.0]))  # looks along map x, left is map y
    forward = {"ros": [1, 0, 0], "opencv": [0, 0, 1], "webxr": [0, 0, -1], "unity": [0, 0, 1]}
    map_x = {"ros": [1, 0, 0], "opencv": [1, 0, 0], "webxr": [1, 0, 0], "unity": [1, 0, 0]}
    position = {"ros": [1, 2, 3], "opencv": [1, 2, 3], "webxr": [1, 3, -2], "unity": [1, 3, 2]}
    for frame in FRAMES:
        written = pose.in_frame(frame)
        np.testing.assert_allclose(written.rotation @ forward[frame], map_x[frame], atol=1e-12)
        np.testing.assert_allclose(written.position, position[frame])


def write_ply(path: Path, points: np.ndarray) -> Path:
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property double {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    lines += ["end_header", *(f"{x!r} {y!r} {z!r} 10 200 30" for x, y, z in points.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_y_up_scan_is_z_up_after_reading_and_that_is_recorded(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, (4, 2, 3), (50, 3))  # two metres high along y
    cloud = read_scan(write_ply(tmp_path / "scan.ply", points), ScanOptions(up_axis="y"))
    heights = np.sort(cloud.positions[:, 2] + cloud.origin_offset[2])
    np.testing.assert_allclose(heights, np.sort(points[:, 1]), atol=1e-5)
    assert any("up" in diagnostic.message or "up" in diagnostic.code for diagnostic in cloud.diagnostics)


def test_a_scan_in_centimetres_is_in_metres_after_reading(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, (400, 300, 200), (50, 3))
    cloud = read_scan(write_ply(tmp_path / "scan.ply", points), ScanOptions(unit="cm"))
    extent = cloud.positions.max(axis=0) - cloud.positions.min(axis=0)
    np.testing.assert_allclose(extent, (points.max(axis=0) - points.min(axis=0)) / 100, atol=1e-4)


def test_survey_coordinates_lose_nothing_to_single_precision(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(0, 3, (50, 3)) + np.array([4.5e6, 5.4e6, 300.0])
    cloud = read_scan(write_ply(tmp_path / "scan.ply", points))
    assert cloud.origin_offset.dtype == np.float64
    whole = cloud.positions.astype(np.float64) + cloud.origin_offset
    np.testing.assert_allclose(np.sort(whole[:, 0]), np.sort(points[:, 0]), atol=1e-5)


# Panoramas.


# Names.


# Docstrings.
