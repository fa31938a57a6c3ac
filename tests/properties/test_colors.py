"""Canonical colours, whatever the light."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from panoloc.core.describe.patch_histograms import hard_histograms, soft_histograms
from panoloc.core.light.color_equalization import equalize, label_codes, transport
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


@pytest.mark.slow
@given(byte_colors, byte_colors)
def test_transport_stays_within_the_colours_of_the_target(source: np.ndarray, target: np.ndarray) -> None:
    found = transport(as_image(source)[0], torch.ones(len(source)), as_image(target)[0], torch.ones(len(target)))
    for channel in range(3):
        assert float(found[:, channel].min()) >= target[:, channel].min() / 255 - 1e-6
        assert float(found[:, channel].max()) <= target[:, channel].max() / 255 + 1e-6


@given(byte_colors, st.sampled_from((hard_histograms, soft_histograms)), st.integers(0, 2**31))
def test_histograms_sum_to_one_and_do_not_depend_on_the_order_of_pixels(
    colors: np.ndarray, histograms: object, seed: int
) -> None:
    weights = torch.rand((1, len(colors)), generator=torch.Generator().manual_seed(seed)) + 0.1
    patch = torch.zeros((1, len(colors)), dtype=torch.long)
    order = torch.randperm(len(colors), generator=torch.Generator().manual_seed(seed))
    one = histograms(as_image(colors), weights, patch, 1, 8)  # type: ignore[operator]
    other = histograms(as_image(colors)[:, order], weights[:, order], patch, 1, 8)  # type: ignore[operator]
    assert abs(float(one.sum()) - 1) < 1e-5
    torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-4)


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
