"""The vectorised projection and sampling against one point at a time."""

import numpy as np
import torch

from panoloc.core.geometry.projection import (
    pixel_directions,
    pixel_solid_angles,
    project,
    sample_bilinear,
    unproject,
    wrap_border,
)
from tests.reference.spherical_twin import direction_of, image_position_of, pixel_at, pixel_solid_angle, sample


def random_points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * [1.0, 2.0, 0.7]


def test_projection_agrees_with_the_formula_point_by_point() -> None:
    points = random_points(300)
    u, v = project(torch.from_numpy(points), 256, 512)
    expected = np.array([image_position_of(point, 256, 512) for point in points])
    np.testing.assert_allclose(u.numpy(), expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(v.numpy(), expected[:, 1], atol=1e-9)


def test_unprojection_agrees_with_the_formula_point_by_point() -> None:
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0, 512, 200), rng.uniform(0, 256, 200)
    found = unproject(torch.from_numpy(u), torch.from_numpy(v), 256, 512).numpy()
    np.testing.assert_allclose(found, [direction_of(a, b, 256, 512) for a, b in zip(u, v, strict=True)], atol=1e-12)


def test_pixel_directions_look_through_pixel_centres() -> None:
    found = pixel_directions(6, 12).numpy()
    for row in range(6):
        for column in range(12):
            np.testing.assert_allclose(found[row, column], direction_of(column + 0.5, row + 0.5, 6, 12), atol=1e-6)


def test_solid_angles_agree_with_numerical_integration_and_cover_the_sphere() -> None:
    found = pixel_solid_angles(16, 32)[:, 0].numpy()
    np.testing.assert_allclose(found, [pixel_solid_angle(row, 16, 32) for row in range(16)], rtol=1e-4)
    assert abs(float(found.sum()) * 32 - 4 * np.pi) < 1e-4


def test_the_border_continues_the_sphere_around_the_seam_and_over_the_poles() -> None:
    image = np.random.default_rng(2).normal(size=(4, 8, 2))
    bordered = wrap_border(torch.from_numpy(image).permute(2, 0, 1)).permute(1, 2, 0).numpy()
    for row in range(-1, 5):
        for column in range(-1, 9):
            np.testing.assert_array_equal(bordered[row + 1, column + 1], pixel_at(image, row, column))


def test_bilinear_samples_agree_with_the_twin_everywhere_also_at_seam_and_poles() -> None:
    rng = np.random.default_rng(3)
    image = rng.uniform(size=(8, 16, 3))
    u, v = rng.uniform(0, 16, 400), rng.uniform(0, 8, 400)
    u[:40], u[40:80] = rng.uniform(0, 0.5, 40), rng.uniform(15.5, 16, 40)
    v[80:120], v[120:160] = rng.uniform(0, 0.5, 40), rng.uniform(7.5, 8, 40)
    found = sample_bilinear(torch.from_numpy(image).permute(2, 0, 1), torch.from_numpy(u), torch.from_numpy(v))
    expected = [sample(image, a, b) for a, b in zip(u, v, strict=True)]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)
