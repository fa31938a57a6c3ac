"""Projection, sampling and patches, whatever the direction."""

import math

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.core.describe.spherical_patches import PatchGrid
from panoloc.core.geometry.projection import project, sample_bilinear, unproject
from tests.properties.strategies import Array, finite, vectors

HEIGHTS = st.sampled_from((4, 16, 100, 512))


@given(finite(0, 1), finite(1e-4, 1 - 1e-4), HEIGHTS)
def test_projecting_what_was_unprojected_gives_the_same_image_position(x: float, y: float, height: int) -> None:
    width = 2 * height
    u, v = torch.tensor(x * width, dtype=torch.float64) % width, torch.tensor(y * height, dtype=torch.float64)
    found_u, found_v = project(unproject(u, v, height, width), height, width)
    difference = abs(float(found_u - u))
    assert min(difference, width - difference) < 1e-6
    assert abs(float(found_v - v)) < 1e-6


@given(vectors, HEIGHTS)
def test_unprojecting_what_was_projected_gives_the_direction(vector: Array, height: int) -> None:
    length = np.linalg.norm(vector)
    if length < 1e-6:
        return
    found = unproject(*project(torch.from_numpy(vector), height, 2 * height), height, 2 * height).numpy()
    np.testing.assert_allclose(found, vector / length, atol=1e-9)


@given(vectors, HEIGHTS)
def test_image_positions_never_leave_the_image_also_in_single_precision(vector: Array, height: int) -> None:
    for points in (torch.from_numpy(vector), torch.from_numpy(vector).float()):
        u, v = project(points, height, 2 * height)
        assert 0 <= float(u) < 2 * height
        assert 0 <= float(v) <= height


@given(finite(-1e-3, 1e-3), finite(-1.5, 1.5), st.integers(0, 2**31))
def test_sampling_is_continuous_across_the_seam(azimuth_step: float, elevation: float, seed: int) -> None:
    image = torch.rand((2, 8, 16), dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    sides = []
    for azimuth in (math.pi - abs(azimuth_step), -math.pi + abs(azimuth_step)):
        direction = torch.tensor(
            [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)],
            dtype=torch.float64,
        )
        sides.append(sample_bilinear(image, *project(direction, 8, 16)))
    assert float((sides[0] - sides[1]).abs().max()) <= 2 * abs(azimuth_step) * 16 / (2 * math.pi) + 1e-9


@given(finite(-math.pi, math.pi), st.sampled_from((-1.0, 1.0)), st.integers(0, 2**31))
def test_sampling_is_continuous_across_the_poles(azimuth: float, pole: float, seed: int) -> None:
    image = torch.rand((2, 8, 16), dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    tiny = 1e-7
    sides = []
    for side in (tiny, -tiny):
        direction = torch.tensor([side * math.cos(azimuth), side * math.sin(azimuth), pole], dtype=torch.float64)
        sides.append(sample_bilinear(image, *project(direction, 8, 16)))
    assert float((sides[0] - sides[1]).abs().max()) < 1e-5


@given(finite(0, 16), finite(0, 8), finite(-2, 2))
def test_a_picture_of_one_colour_samples_as_that_colour_everywhere(u: float, v: float, value: float) -> None:
    image = torch.full((1, 8, 16), value, dtype=torch.float64)
    sampled = sample_bilinear(image, torch.tensor(u, dtype=torch.float64), torch.tensor(v, dtype=torch.float64))
    assert abs(float(sampled) - value) < 1e-9


@settings(max_examples=50)
@given(vectors, st.sampled_from(((4, 8), (8, 16), (16, 32), (3, 5))))
def test_every_direction_lies_in_the_patch_with_the_nearest_centre(vector: Array, shape: tuple[int, int]) -> None:
    grid = PatchGrid(*shape)
    patch = int(grid.patch_of_direction(torch.from_numpy(vector)))
    u, v = (float(value) for value in project(torch.from_numpy(vector), *shape))
    centers = np.array([(c + 0.5, r + 0.5) for r in range(shape[0]) for c in range(shape[1])])
    across = np.abs(centers[:, 0] - u)
    distance = np.hypot(np.minimum(across, shape[1] - across), centers[:, 1] - v)
    assert distance[patch] <= distance.min() + 1e-9


@given(st.sampled_from(((4, 8), (8, 16), (3, 5))), st.sampled_from((1, 2, 5)))
def test_patches_share_out_pixels_and_the_sphere(shape: tuple[int, int], factor: int) -> None:
    grid = PatchGrid(*shape)
    patch = grid.patch_of_pixel(shape[0] * factor, shape[1] * factor)
    assert torch.bincount(patch.flatten(), minlength=len(grid)).tolist() == [factor * factor] * len(grid)
    assert abs(float(grid.solid_angles().sum()) - 4 * math.pi) < 1e-4
