"""Equalization and 1-D optimal transport against sorting."""

import numpy as np
import torch

from panoloc.core.light.color_equalization import equalize, transport
from tests.reference.color_twin import matched_by_sorting, rank_of


def byte_colors(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(0, 256, (count, 3)) / 255


def test_equalization_gives_the_weighted_share_of_darker_pixels() -> None:
    rng = np.random.default_rng(0)
    colors, weights = byte_colors(rng, 150), rng.uniform(size=150)
    weights[:30] = 0.0
    found = equalize(torch.from_numpy(colors).float()[None], torch.from_numpy(weights).float()[None])[0].numpy()
    for channel in range(3):
        np.testing.assert_allclose(found[:, channel], rank_of(colors[:, channel], weights), atol=1e-5)


def test_transport_moves_the_kth_value_to_the_kth_value() -> None:
    rng = np.random.default_rng(1)
    count = 2000
    source, target = rng.beta(2, 5, (count, 3)), rng.beta(4, 2, (count, 3))
    ones = torch.ones(count)
    found = transport(torch.from_numpy(source).float(), ones, torch.from_numpy(target).float(), ones).numpy()
    for channel in range(3):
        expected = matched_by_sorting(source[:, channel], target[:, channel])
        assert np.abs(found[:, channel] - expected).mean() < 1 / 255
        assert np.quantile(np.abs(found[:, channel] - expected), 0.99) < 4 / 255


def test_transport_weighs_pixels_by_their_solid_angle() -> None:
    # Half of the pixels are black but weigh one percent: the match must treat the source as almost white.
    source = torch.cat((torch.zeros(50, 3), torch.ones(50, 3)))
    weights = torch.cat((torch.full((50,), 0.01), torch.full((50,), 0.99)))
    target = torch.linspace(0, 1, 256)[:, None].expand(-1, 3).contiguous()
    found = transport(source, weights, target, torch.ones(256))
    assert abs(float(found[-1, 0]) - 0.5) < 0.02
    assert float(found[0, 0]) < 0.02


def test_transport_ignores_pixels_of_no_weight() -> None:
    rng = np.random.default_rng(3)
    source, target = byte_colors(rng, 80), byte_colors(rng, 90)
    weights = torch.ones(80)
    weights[40:] = 0
    changed = source.copy()
    changed[40:] = 0.7
    arguments = weights, torch.from_numpy(target).float(), torch.ones(90)
    one = transport(torch.from_numpy(source).float(), *arguments)[:40]
    other = transport(torch.from_numpy(changed).float(), *arguments)[:40]
    torch.testing.assert_close(one, other)
