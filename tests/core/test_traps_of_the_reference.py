"""The traps of the reference implementation, each shut (docs/method.md)."""

import dataclasses

import numpy as np
import pytest
import torch

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.image.rig_pyramid import RigPyramid, Windows
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import IndexOptions
from tests.core.painted_box import PaintedBox


def windows_of(panorama: Panorama, rows: int) -> Windows:
    return RigPyramid(Rig.of_panorama(panorama), 64, None, "cpu").windows(rows)


def test_a_black_wall_is_not_a_missing_pixel_in_the_pyramid() -> None:
    color = np.full((64, 128, 3), 200, np.uint8)
    color[:, :64] = 0
    (window,) = windows_of(Panorama(color, np.ones((64, 128), bool)), 32).each
    assert bool((window.valid == 1).all())
    assert float(window.color[:, :, :32].max()) == 0.0


def test_a_masked_pixel_does_not_darken_its_neighbours_when_the_panorama_is_scaled_down() -> None:
    color = np.full((64, 128, 3), 200, np.uint8)
    valid = np.ones((64, 128), bool)
    valid[::2, 1::2] = False
    color[~valid] = 0
    for height in (64, 32, 16):
        (window,) = windows_of(Panorama(color, valid), height).each
        seen = window.color[:, window.valid > 0]
        torch.testing.assert_close(seen, torch.full_like(seen, 200 / 255))


@pytest.mark.slow
def test_a_scan_of_black_walls_is_described_like_one_of_any_other_colour() -> None:
    box = PaintedBox(seed=2, size_m=(3.0, 3.0, 2.4))
    cloud = box.scan(6_000)
    options = IndexOptions(starts_method="grid", spacing_m=1.4)
    half = cloud.positions[:, 0] < 1.5
    black, grey = cloud.colors.copy(), cloud.colors.copy()
    black[half], grey[half] = 0, 1
    one = build_map_index(dataclasses.replace(cloud, colors=black), options)
    other = build_map_index(dataclasses.replace(cloud, colors=grey), options)
    torch.testing.assert_close(one.views.weights, other.views.weights)
    assert torch.equal(one.sampled_shares, other.sampled_shares)
