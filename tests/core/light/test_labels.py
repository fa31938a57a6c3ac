"""Codes of semantic labels."""

import numpy as np
import torch

from panoloc.core.light.color_equalization import label_codes
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.panorama.pyramid import PanoramaPyramid


def test_rare_colours_are_noise_not_labels() -> None:
    colors = torch.zeros((50_000, 3), dtype=torch.uint8)
    colors[25_000:] = 255
    colors[7] = torch.tensor([9, 99, 199], dtype=torch.uint8)
    assert len(label_codes(colors).labels) == 2


def test_an_unknown_label_in_a_panorama_is_masked() -> None:
    scan = torch.tensor([[255, 0, 0], [0, 0, 255]], dtype=torch.uint8).repeat(100, 1)
    color = np.zeros((64, 128, 3), np.uint8)
    color[:, :64] = [255, 0, 0]
    color[:, 64:] = [10, 200, 90]
    level = PanoramaPyramid(Panorama(color, np.ones((64, 128), bool)), 64, label_codes(scan), "cpu").level(64)
    assert bool((level.valid[:, :64] == 1).all())
    assert bool((level.valid[:, 64:] == 0).all())
