"""The traps of the reference implementation, each shut (docs/method.md)."""

import dataclasses
import inspect

import numpy as np
import pytest
import torch

import core.index.map_builder
from core.describe.spherical_patches import PatchGrid
from core.geometry.projection import project, sample_bilinear
from core.index.map_builder import build_map_index
from core.index.map_index import MapIndex
from core.options import Hints, IndexOptions
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaPyramid
from core.paper.sampling_loss import SamplingProblem, sampling_loss
from tests.core.painted_box import PaintedBox


def ramp(height: int) -> torch.Tensor:
    """Return an image (1, H, W) whose every column has its own value, without a jump at the seam."""
    columns = torch.arange(2 * height) + 0.5
    return (torch.cos(columns * torch.pi / height))[None, None].expand(1, height, -1).contiguous()


def test_no_column_next_to_the_seam_is_folded_onto_another() -> None:
    height = 512
    image = ramp(height)
    columns = torch.cat((torch.arange(12), 2 * height - 12 + torch.arange(12))) + 0.5
    sampled = sample_bilinear(image, columns, torch.full_like(columns, height / 2))
    torch.testing.assert_close(sampled[:, 0], torch.cos(columns * torch.pi / height), atol=1e-5, rtol=0)


def test_no_row_next_to_a_pole_is_folded_onto_another() -> None:
    height = 256
    image = (torch.arange(height) + 0.5)[None, :, None].expand(1, -1, 2 * height).contiguous()
    rows = torch.cat((torch.arange(6), height - 6 + torch.arange(6))) + 0.5
    sampled = sample_bilinear(image, torch.full_like(rows, 100.0), rows)
    torch.testing.assert_close(sampled[:, 0], rows, atol=1e-3, rtol=0)


def test_a_sample_between_the_last_and_the_first_column_is_the_mean_of_both() -> None:
    image = torch.zeros((1, 4, 8))
    image[..., 0], image[..., 7] = 1.0, 3.0
    assert float(sample_bilinear(image, torch.tensor(0.0), torch.tensor(2.0))) == 2.0


def test_a_point_drawn_at_a_pixel_centre_is_sampled_there() -> None:
    image = torch.rand((1, 16, 32), generator=torch.Generator().manual_seed(0))
    for row, column in ((0, 0), (7, 31), (15, 16)):
        from core.geometry.projection import pixel_directions

        u, v = project(pixel_directions(16, 32)[row, column].double(), 16, 32)
        assert abs(float(sample_bilinear(image.double(), u, v)) - float(image[0, row, column])) < 1e-5


def test_a_black_wall_is_not_a_missing_pixel_in_the_pyramid() -> None:
    color = np.full((64, 128, 3), 200, np.uint8)
    color[:, :64] = 0
    level = PanoramaPyramid(Panorama(color, np.ones((64, 128), bool)), 32, None, "cpu").level(32)
    assert bool((level.valid == 1).all())
    assert float(level.color[:, :, :32].max()) == 0.0


def test_a_masked_pixel_does_not_darken_its_neighbours_when_the_panorama_is_scaled_down() -> None:
    color = np.full((64, 128, 3), 200, np.uint8)
    valid = np.ones((64, 128), bool)
    valid[::2, 1::2] = False
    color[~valid] = 0
    for height in (64, 32, 16):
        level = PanoramaPyramid(Panorama(color, valid), 64, None, "cpu").level(height)
        seen = level.valid > 0
        torch.testing.assert_close(level.color[:, seen], torch.full_like(level.color[:, seen], 200 / 255))


def test_a_black_point_has_its_part_in_the_sampling_loss() -> None:
    problem = SamplingProblem(
        torch.ones((3, 8, 16)),
        torch.ones((8, 16)),
        torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]),
        torch.ones(2),
        torch.ones(8),
        PatchGrid(2, 4),
    )
    loss = sampling_loss(problem, torch.eye(3), torch.zeros(3))
    assert abs(float(loss) - np.sqrt(3 / 2)) < 1e-5


def test_the_map_is_described_without_any_query() -> None:
    assert "Panorama" not in inspect.getsource(core.index.map_builder)


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
    torch.testing.assert_close(one.descriptors.weights, other.descriptors.weights)
    assert torch.equal(one.sampled_shares, other.sampled_shares)


def test_hints_speak_of_the_camera_position_in_the_maps_own_frame(box_index: MapIndex) -> None:
    from core.search.pose_limits import pose_limits

    moved = dataclasses.replace(box_index, origin_offset=np.array([1000.0, 2000.0, 30.0]))
    limits = pose_limits(Hints(position_m=(1001.0, 2002.0, 31.0), radius_m=0.5), moved)
    inside = limits.allows_position(torch.tensor([[1.0, 2.0, 1.0], [1.0, 2.0, 1.6], [1.3, 2.3, 1.2]]))
    assert inside.tolist() == [True, False, True]
