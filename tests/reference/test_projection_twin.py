"""The vectorised projection and sampling against one point at a time, and against the conventions by hand."""

import math

import numpy as np
import pytest
import torch

from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import (
    pixel_directions,
    pixel_solid_angles,
    project,
    sample_bilinear,
    unproject,
    wrap_border,
)
from tests.core.painted_box import rotation_of
from tests.reference.spherical_twin import direction_of, image_position_of, pixel_at, pixel_solid_angle, sample


@pytest.mark.parametrize(
    ("direction", "position"),
    [((1, 0, 0), (64, 32)), ((-1, 0, 0), (0, 32)), ((0, 1, 0), (32, 32)), ((0, -1, 0), (96, 32))],
    ids=["ahead", "behind", "left", "right"],
)
def test_the_middle_of_the_image_is_ahead_and_its_left_is_left(
    direction: tuple[float, ...], position: tuple[float, ...]
) -> None:
    found = project(torch.tensor(direction, dtype=torch.float64), 64, 128)
    assert [float(each) for each in found] == pytest.approx(position)


def test_the_top_row_is_up() -> None:
    assert [float(project(torch.tensor([0.0, 0.0, z]), 64, 128)[1]) for z in (1.0, -1.0)] == [0.0, 64.0]


def test_the_projection_is_colmaps_equirectangular_up_to_the_axes() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    u, v = project(torch.from_numpy(points), 64, 128)
    for (x, y, z), found in zip(points, zip(u, v, strict=True), strict=True):
        x_cv, y_cv, z_cv = -y, -z, x
        longitude, latitude = math.atan2(x_cv, z_cv), math.atan2(-y_cv, math.hypot(x_cv, z_cv))
        expected = (longitude / (2 * math.pi) + 0.5) * 128, (0.5 - latitude / math.pi) * 64
        assert [float(each) for each in found] == pytest.approx(expected)


def test_a_pose_maps_camera_coordinates_to_map_coordinates_and_its_position_is_the_camera() -> None:
    pose = Pose(rotation_of(90.0), np.array([10.0, 20.0, 1.5]))
    np.testing.assert_allclose(pose.matrix @ [2.0, 0.0, 0.0, 1.0], [10.0, 22.0, 1.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(pose.matrix @ [0, 0, 0, 1], [10.0, 20.0, 1.5, 1.0])


def test_projection_agrees_with_the_formula_point_by_point() -> None:
    points = np.random.default_rng(0).normal(size=(300, 3)) * [1.0, 2.0, 0.7]
    found = np.stack(project(torch.from_numpy(points), 256, 512), axis=-1)
    np.testing.assert_allclose(found, [image_position_of(point, 256, 512) for point in points], atol=1e-9)


def test_unprojection_agrees_with_the_formula_point_by_point() -> None:
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0, 512, 200), rng.uniform(0, 256, 200)
    found = unproject(torch.from_numpy(u), torch.from_numpy(v), 256, 512).numpy()
    np.testing.assert_allclose(found, [direction_of(a, b, 256, 512) for a, b in zip(u, v, strict=True)], atol=1e-12)


def test_pixel_directions_look_through_pixel_centres() -> None:
    found = pixel_directions(6, 12).numpy()
    for row, column in np.ndindex(6, 12):
        np.testing.assert_allclose(found[row, column], direction_of(column + 0.5, row + 0.5, 6, 12), atol=1e-6)


def test_solid_angles_agree_with_numerical_integration_and_cover_the_sphere() -> None:
    found = pixel_solid_angles(16, 32)[:, 0].numpy()
    np.testing.assert_allclose(found, [pixel_solid_angle(row, 16, 32) for row in range(16)], rtol=1e-4)
    assert abs(float(found.sum()) * 32 - 4 * np.pi) < 1e-4


def test_the_border_continues_the_sphere_around_the_seam_and_over_the_poles() -> None:
    image = np.random.default_rng(2).normal(size=(4, 8, 2))
    bordered = wrap_border(torch.from_numpy(image).permute(2, 0, 1)).permute(1, 2, 0).numpy()
    for row, column in np.ndindex(6, 10):
        np.testing.assert_array_equal(bordered[row, column], pixel_at(image, row - 1, column - 1))


def test_bilinear_samples_agree_with_the_twin_everywhere_also_at_seam_and_poles() -> None:
    rng = np.random.default_rng(3)
    image = rng.uniform(size=(8, 16, 3))
    u, v = rng.uniform(0, 16, 400), rng.uniform(0, 8, 400)
    u[:40], u[40:80] = rng.uniform(0, 0.5, 40), rng.uniform(15.5, 16, 40)
    v[80:120], v[120:160] = rng.uniform(0, 0.5, 40), rng.uniform(7.5, 8, 40)
    found = sample_bilinear(torch.from_numpy(image).permute(2, 0, 1), torch.from_numpy(u), torch.from_numpy(v))
    expected = [sample(image, a, b) for a, b in zip(u, v, strict=True)]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)
