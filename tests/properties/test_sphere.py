"""Projection, sampling and patches, whatever the direction."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.geometry.projection import project
from tests.properties.strategies import Array, vectors

HEIGHTS = st.sampled_from((4, 16, 100, 512))


@given(vectors, HEIGHTS)
def test_image_positions_never_leave_the_image_also_in_single_precision(vector: Array, height: int) -> None:
    for points in (torch.from_numpy(vector), torch.from_numpy(vector).float()):
        u, v = project(points, height, 2 * height)
        assert 0 <= float(u) < 2 * height
        assert 0 <= float(v) <= height


@given(st.sampled_from(((4, 8), (8, 16), (3, 5))), st.sampled_from((1, 2, 5)))
def test_patches_share_out_pixels_and_the_sphere(shape: tuple[int, int], factor: int) -> None:
    grid = PatchGrid(*shape)
    patch = grid.patch_of_pixel(shape[0] * factor, shape[1] * factor)
    assert torch.bincount(patch.flatten(), minlength=len(grid)).tolist() == [factor * factor] * len(grid)
    assert abs(float(grid.solid_angles().sum()) - 4 * math.pi) < 1e-4
