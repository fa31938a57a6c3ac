"""Colours that are equalized, fitted in gain and offset, or taken for labels."""

import numpy as np
import pytest
import torch

from panoloc.core.light.color_equalization import apply_tables, equalization_tables, equalize_where, label_codes
from panoloc.core.light.light_fit import fit_gain_offset
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.panorama.pyramid import PanoramaPyramid


def test_equalizing_only_where_something_is_seen_gives_the_same_there_and_nothing_elsewhere() -> None:
    generator = torch.Generator().manual_seed(4)
    color = torch.rand((3, 200, 3), generator=generator)
    where = torch.rand((3, 200), generator=generator) < 0.2
    weights = torch.rand((3, 200), generator=generator) * where * (torch.arange(200) % 3 > 0)
    tables = equalization_tables(color, weights)
    found, found_tables = equalize_where(color, weights, where)
    torch.testing.assert_close(found_tables, tables, atol=1e-5, rtol=0)
    torch.testing.assert_close(found[where], apply_tables(color, tables)[where], atol=1e-5, rtol=0)
    assert float(found[~where].abs().max()) == 0


def test_rare_colours_are_noise_not_labels() -> None:
    colors = torch.zeros((50_000, 3), dtype=torch.uint8)
    colors[25_000:] = 255
    colors[7] = torch.tensor([9, 99, 199], dtype=torch.uint8)
    assert len(label_codes(colors).labels) == 2


def test_an_unknown_label_in_a_panorama_is_masked() -> None:
    scan = torch.tensor([[255, 0, 0], [0, 0, 255]], dtype=torch.uint8).repeat(100, 1)
    color = np.full((64, 128, 3), (255, 0, 0), np.uint8)
    color[:, 64:] = [10, 200, 90]
    level = PanoramaPyramid(Panorama(color, np.ones((64, 128), bool)), 64, label_codes(scan), "cpu").level(64)
    assert bool((level.valid[:, :64] == 1).all())
    assert bool((level.valid[:, 64:] == 0).all())


def test_gain_and_offset_are_those_of_a_weighted_line_fit() -> None:
    rng = np.random.default_rng(0)
    source = rng.uniform(size=(200, 3))
    target = source * [0.8, 1.5, 0.6] + [0.1, -0.2, 0.05] + rng.normal(0, 0.01, (200, 3))
    weights = rng.uniform(size=200)
    gain, offset = fit_gain_offset(*(torch.from_numpy(each)[None] for each in (source, target, weights)))
    lines = [np.polyfit(source[:, channel], target[:, channel], 1, w=np.sqrt(weights)) for channel in range(3)]
    np.testing.assert_allclose(np.stack((gain[0], offset[0]), axis=1), lines, atol=0.02)


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
