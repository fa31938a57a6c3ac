"""Canonical colours, whatever the light."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from panoloc.core.light.color_equalization import equalize, label_codes
from tests.properties.strategies import byte_colors

# A strictly growing tone curve on the 256 levels, one per channel: which levels are in use, in order.
tone_curves = st.lists(st.sets(st.integers(0, 255), min_size=60, max_size=60).map(sorted), min_size=3, max_size=3).map(
    np.array
)


def as_image(colors: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(colors.astype(np.float32) / 255)[None]


@pytest.mark.slow
@given(byte_colors, tone_curves)
def test_equalization_does_not_see_a_growing_tone_curve_per_channel(colors: np.ndarray, curves: np.ndarray) -> None:
    levels = colors % 60
    changed = np.stack([curves[channel][levels[:, channel]] for channel in range(3)], axis=1)
    weights = torch.ones((1, len(colors)))
    torch.testing.assert_close(equalize(as_image(levels), weights), equalize(as_image(changed), weights))


@given(byte_colors)
def test_equalized_colours_keep_the_order_of_brightness_and_stay_in_range(colors: np.ndarray) -> None:
    found = equalize(as_image(colors), torch.ones((1, len(colors))))[0].numpy()
    assert found.min() >= 0
    assert found.max() <= 1
    for channel in range(3):
        order = np.argsort(colors[:, channel], kind="stable")
        assert (np.diff(found[order, channel]) >= -1e-6).all()


@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 30), st.just(3))), st.integers(-10, 10))
def test_label_colours_survive_the_noise_of_compression(labels: np.ndarray, noise: int) -> None:
    separated = (labels // 64 * 64 + 20).astype(np.uint8)
    codes = label_codes(torch.from_numpy(separated))
    exact, known = codes.recode(torch.from_numpy(separated))
    noisy, noisy_known = codes.recode(torch.from_numpy((separated.astype(int) + noise).astype(np.uint8)))
    assert bool(known.all())
    assert bool(noisy_known.all())
    assert torch.equal(exact, noisy)
    num_labels, num_codes = len(np.unique(separated, axis=0)), len(torch.unique(codes.codes, dim=0))
    assert num_labels == num_codes
