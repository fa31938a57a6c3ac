"""Gain and offset against an ordinary line fit."""

import numpy as np
import pytest
import torch

from core.light.light_fit import fit_gain_offset


def test_gain_and_offset_are_those_of_a_weighted_line_fit() -> None:
    rng = np.random.default_rng(0)
    source = rng.uniform(size=(200, 3))
    target = source * [0.8, 1.5, 0.6] + [0.1, -0.2, 0.05] + rng.normal(0, 0.01, (200, 3))
    weights = rng.uniform(size=200)
    gain, offset = fit_gain_offset(
        torch.from_numpy(source)[None], torch.from_numpy(target)[None], torch.from_numpy(weights)[None]
    )
    for channel in range(3):
        slope, intercept = np.polyfit(source[:, channel], target[:, channel], 1, w=np.sqrt(weights))
        assert float(gain[0, channel]) == pytest.approx(slope, abs=0.02)
        assert float(offset[0, channel]) == pytest.approx(intercept, abs=0.02)
