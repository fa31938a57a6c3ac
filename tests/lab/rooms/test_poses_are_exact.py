"""The pose, the panorama and the scan agree, shown by projecting points with formulas written here."""

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scan, Scene, View, scan_with_truth, take_panorama
from panoloc.lab.rooms.capture.views import viewing_directions


def pixel_of(points: NDArray[np.floating], pose: Pose, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of map points, from azimuth and elevation as in conventions.md."""
    x, y, z = ((points - pose.position) @ pose.rotation).T
    column = (np.pi - np.arctan2(y, x)) * width / (2 * np.pi)
    row = (np.pi / 2 - np.arctan2(z, np.hypot(x, y))) * width / (2 * np.pi)
    return np.floor(row).astype(int).clip(0, width // 2 - 1), np.floor(column).astype(int) % width


def visible_from(points: NDArray[np.floating], view: View, width: int) -> NDArray[np.bool_]:
    """Tell which points are as far away as what their pixel saw, and well inside one surface there."""
    row, column = pixel_of(points, view.pose, width)
    seen = view.hits.distance.reshape(width // 2, width)
    near = np.stack([np.roll(seen, shift, (0, 1)) for shift in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))])
    smooth = np.ptp(near, axis=0) < 0.06
    distance = np.linalg.norm(points - view.pose.position, axis=1)
    visible: NDArray[np.bool_] = smooth[row, column] & (np.abs(distance - seen[row, column]) < 0.03)
    return visible


@pytest.mark.parametrize(
    ("column", "row", "direction"),
    [(512, 256, (1, 0, 0)), (256, 256, (0, 1, 0)), (768, 256, (0, -1, 0)), (100, 0, (0, 0, 1)), (0, 256, (-1, 0, 0))],
)
def test_the_image_centre_looks_forward_and_columns_run_clockwise(
    column: float, row: float, direction: tuple[float, float, float]
) -> None:
    found = viewing_directions(np.array(column), np.array(row), 1024)
    np.testing.assert_allclose(found, direction, atol=1e-12)


@pytest.mark.slow
def test_scanned_colors_are_found_where_the_pose_projects_their_points(room_scan: Scan, room_view: View) -> None:
    visible = visible_from(room_scan.exact_positions, room_view, 512)
    assert visible.sum() > 5000
    row, column = pixel_of(room_scan.exact_positions[visible], room_view.pose, 512)
    seen = room_view.panorama.color[row, column].astype(float)
    difference = np.abs(seen - room_scan.cloud.colors[visible]).mean(1)
    assert np.median(difference) < 6
    assert (difference < 40).mean() > 0.93


def test_a_pose_off_by_five_centimetres_fits_the_colors_worse(room_scan: Scan, room_view: View) -> None:
    visible = visible_from(room_scan.exact_positions, room_view, 512)
    points, colors = room_scan.exact_positions[visible], room_scan.cloud.colors[visible].astype(float)

    def misfit(shift: tuple[float, float, float]) -> float:
        row, column = pixel_of(points, Pose(room_view.pose.rotation, room_view.pose.position + shift), 512)
        return float(np.abs(room_view.panorama.color[row, column] - colors).mean())

    exact = misfit((0, 0, 0))
    for shift in ((0.05, 0, 0), (-0.05, 0, 0), (0, 0.05, 0), (0, -0.05, 0), (0, 0, 0.05), (0, 0, -0.05)):
        assert misfit(shift) > 1.03 * exact


def test_labels_of_scan_and_panorama_agree(room: Scene, room_view: View) -> None:
    scan = scan_with_truth(room, num_points=40_000, noise_m=0.0, color_kind="labels")
    panorama = take_panorama(room, room_view.pose, 512, "labels")
    visible = visible_from(scan.exact_positions, room_view, 512)
    row, column = pixel_of(scan.exact_positions[visible], room_view.pose, 512)
    same = (panorama.color[row, column] == scan.cloud.colors[visible]).all(1)
    assert same.mean() > 0.97
