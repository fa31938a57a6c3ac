"""Packed arrays come back: whole numbers exactly, colours but for the stated rounding."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from panoloc.core.map.map_codec import pack_colors, pack_steps, unpack_colors, unpack_steps

COLORS = arrays(np.uint8, array_shapes(min_dims=1, max_dims=2, max_side=9).map(lambda shape: (*shape, 3)))


@given(arrays(np.int64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.integers(0, 1 << 30)))
def test_steps_come_back_exactly(steps: np.ndarray) -> None:
    np.testing.assert_array_equal(unpack_steps(pack_steps(steps)), steps)


@pytest.mark.slow
@pytest.mark.parametrize("levels", [32, 64, 256])
@given(colors=COLORS)
def test_colors_come_back_within_half_a_step(levels: int, colors: np.ndarray) -> None:
    back = unpack_colors(pack_colors(colors, levels), levels)
    assert np.abs(back.astype(int) - colors.astype(int)).max() <= 255 / (levels - 1) / 2 + 0.5


@pytest.mark.slow
@pytest.mark.parametrize("levels", [32, 64, 256])
@given(colors=COLORS)
def test_rounding_twice_rounds_no_further(levels: int, colors: np.ndarray) -> None:
    once = unpack_colors(pack_colors(colors, levels), levels)
    np.testing.assert_array_equal(unpack_colors(pack_colors(once, levels), levels), once)


def test_neighbours_on_a_curve_take_one_plane() -> None:
    steps = np.cumsum(np.random.default_rng(0).integers(-100, 100, (500, 3)), axis=0)
    planes = pack_steps(steps - steps.min(axis=0))
    assert not planes[2:].any()
