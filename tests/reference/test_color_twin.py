"""Equalization and 1-D optimal transport against sorting, without look-up tables."""

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.features.equalization import equalize
from panoloc.core.paper.color_matching import transport

Array = NDArray[np.float64]


def rank_of(values: Array, weights: Array) -> Array:
    """Return for each value (N,) the weighted share of values that are smaller, ties counted half."""
    total = weights.sum()
    return np.array([(weights[values < value].sum() + weights[values == value].sum() / 2) / total for value in values])


def matched_by_sorting(source: Array, target: Array) -> Array:
    """Return the optimal transport (N,) of N equally heavy source values to N equally heavy target values: k-th to k-th."""
    matched = np.empty_like(source)
    matched[np.argsort(source, kind="stable")] = np.sort(target)
    return matched


def test_equalization_gives_the_weighted_share_of_darker_pixels() -> None:
    rng = np.random.default_rng(0)
    colors, weights = rng.integers(0, 256, (150, 3)) / 255, rng.uniform(size=150)
    weights[:30] = 0.0
    found = equalize(torch.from_numpy(colors).float()[None], torch.from_numpy(weights).float()[None])[0].numpy()
    for channel in range(3):
        np.testing.assert_allclose(found[:, channel], rank_of(colors[:, channel], weights), atol=1e-5)


def test_transport_moves_the_kth_value_to_the_kth_value() -> None:
    rng = np.random.default_rng(1)
    count = 2000
    source, target = rng.beta(2, 5, (count, 3)), rng.beta(4, 2, (count, 3))
    found = transport(torch.from_numpy(source).float(), torch.ones(count), torch.from_numpy(target).float()).numpy()
    for channel in range(3):
        expected = matched_by_sorting(source[:, channel], target[:, channel])
        assert np.abs(found[:, channel] - expected).mean() < 1 / 255
        assert np.quantile(np.abs(found[:, channel] - expected), 0.99) < 4 / 255


def test_transport_weighs_pixels_by_their_solid_angle() -> None:
    # Half of the pixels are black but weigh one percent: the match must treat the source as almost white.
    source = torch.cat((torch.zeros(50, 3), torch.ones(50, 3)))
    weights = torch.cat((torch.full((50,), 0.01), torch.full((50,), 0.99)))
    target = torch.linspace(0, 1, 256)[:, None].expand(-1, 3).contiguous()
    found = transport(source, weights, target)
    assert abs(float(found[-1, 0]) - 0.5) < 0.02
    assert float(found[0, 0]) < 0.02


def test_transport_ignores_pixels_of_no_weight() -> None:
    source, target = torch.rand((2, 80, 3), generator=torch.Generator().manual_seed(3))
    weights = (torch.arange(80) < 40).float()
    changed = torch.where(weights[:, None] > 0, source, torch.full_like(source, 0.7))
    one, other = (transport(each, weights, target)[:40] for each in (source, changed))
    torch.testing.assert_close(one, other)
