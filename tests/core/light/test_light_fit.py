"""Gain and offset against an ordinary line fit."""

import numpy as np
import pytest
import torch

from panoloc.core.light.light_fit import fit_gain_offset


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


@pytest.mark.parametrize(("slope", "expected"), [(10.0, 3.0), (2.9, 2.9), (0.4, 0.4), (0.1, 0.3), (-1.0, 0.3)])
def test_gains_stay_within_what_cameras_do_and_the_offset_still_meets_the_mean(slope: float, expected: float) -> None:
    source = torch.linspace(0, 1, 200).expand(3, -1).T[None]
    gain, offset = fit_gain_offset(source, slope * source + 0.2, torch.ones((1, 200)))
    assert gain[0].tolist() == pytest.approx([expected] * 3, abs=0.03)
    assert (gain * 0.5 + offset)[0].tolist() == pytest.approx([slope * 0.5 + 0.2] * 3, abs=1e-5)


def test_where_there_is_no_contrast_the_gain_is_one() -> None:
    source = torch.full((1, 50, 3), 0.4)
    gain, offset = fit_gain_offset(source, source + 0.1, torch.ones((1, 50)))
    assert gain[0].tolist() == pytest.approx([1.0] * 3, abs=1e-4)
    assert offset[0].tolist() == pytest.approx([0.1] * 3, abs=1e-4)
