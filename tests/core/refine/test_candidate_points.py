"""The points that candidates are refined on: those that a pose or a start sees, and how much those count that have changed."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.config import RefinementConfig
from panoloc.core.features.local_contrast import mixed_with_contrast
from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles, project
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.refine.candidate_points import points_seen_from_poses, points_seen_from_starts, unchanged_share
from tests.core.built_maps import BOX, map_of

HEIGHT, WIDTH, COUNT = 16, 32, 200


def rendered(tables: bool = True) -> tuple[Any, Any]:
    """Return a cloud and two renderings of it, in which every third pixel shows no point."""
    made = torch.Generator().manual_seed(0)
    positions = torch.randn((HEIGHT * WIDTH, 3), generator=made)
    point = torch.stack([torch.randperm(HEIGHT * WIDTH, generator=made) for _ in range(2)])
    point[:, ::3] = -1
    x, y, z = pixel_directions(HEIGHT, WIDTH).unbind(-1)
    color = (0.5 + 0.4 * torch.stack((x, y * z, z), dim=-1)).expand(2, -1, -1, -1).contiguous()
    views = SimpleNamespace(
        depth=torch.ones((2, HEIGHT, WIDTH)),
        window=SphereWindow.of_sphere(HEIGHT),
        point=point.view(2, HEIGHT, WIDTH),
        color=color,
        valid=torch.ones((2, HEIGHT, WIDTH), dtype=torch.bool),
    )
    scan = torch.rand((2, HEIGHT * WIDTH, 3), generator=made)
    comparison = SimpleNamespace(views=views, scan=scan, tables=torch.zeros(1) if tables else None)
    return SimpleNamespace(positions=positions), comparison


def shown_pixels() -> list[int]:
    """Return the pixels that even directions fall into, each once, in the order of the image."""
    pixels = set()
    for x, y, z in even_directions(COUNT).tolist():
        column = int((math.pi - math.atan2(y, x)) / (2 * math.pi) * WIDTH)
        row = int((math.pi / 2 - math.asin(z)) / math.pi * HEIGHT)
        pixels.add(min(row, HEIGHT - 1) * WIDTH + min(column, WIDTH - 1))
    return sorted(pixels)


def test_each_direction_gives_the_point_that_its_pixel_shows_weighted_by_what_the_pixel_covers() -> None:
    cloud, comparison = rendered()
    found = points_seen_from_poses(cloud, comparison, COUNT, 0.3)
    pixels = shown_pixels()
    number = comparison.views.point.flatten(1)[:, pixels]
    solid = pixel_solid_angles(HEIGHT, WIDTH).expand(-1, WIDTH).flatten()[pixels]
    seen = number >= 0
    assert found.weights.shape == (2, len(pixels))
    assert 0.2 < float((~seen).float().mean()) < 0.5
    torch.testing.assert_close(found.weights, seen * solid / solid.mean())
    torch.testing.assert_close(found.positions[seen], cloud.positions[number[seen]])


def test_points_have_the_colours_of_their_pixels_mixed_with_contrast() -> None:
    cloud, comparison = rendered()
    views = comparison.views
    mixed = mixed_with_contrast(comparison.scan.view(views.color.shape), views.color, views.valid.float(), 0.3)
    found = points_seen_from_poses(cloud, comparison, COUNT, 0.3)
    torch.testing.assert_close(found.colors, mixed.flatten(1, 2)[:, shown_pixels()])
    assert float((found.colors - comparison.scan[:, shown_pixels()]).abs().max()) > 0.05


@pytest.mark.parametrize("regions", [4, 8, 64])
def test_what_agrees_is_told_for_regions_and_not_for_pixels(regions: int) -> None:
    config = RefinementConfig(unchanged_difference=0.4, unchanged_regions=regions)
    rng = np.random.default_rng(0)
    scan, panorama = rng.uniform(size=(2, 2, HEIGHT, WIDTH, 3))
    comparison: Any = SimpleNamespace(
        scan=torch.from_numpy(scan).flatten(1, 2),
        panorama=torch.from_numpy(panorama).flatten(1, 2),
        views=SimpleNamespace(window=SphereWindow.of_sphere(HEIGHT)),
    )
    found = unchanged_share(comparison, config).numpy().reshape(2, HEIGHT, WIDTH)
    agreeing = 1 / (1 + ((scan - panorama) ** 2).sum(-1) / 0.4**2)
    reach = max(1, HEIGHT // regions)
    for k, row, column in ((0, 0, 0), (1, 7, 31), (0, 15, 16), (1, 5, 9), (0, 1, 30)):
        around = [
            agreeing[k, min(max(row + down, 0), HEIGHT - 1), (column + across) % WIDTH]
            for down in range(-reach, reach + 1)
            for across in range(-reach, reach + 1)
        ]
        assert found[k, row, column] == pytest.approx(np.mean(around) ** 2)


def test_points_of_a_start_are_seen_from_it() -> None:
    index = map_of(BOX)
    starts = torch.arange(0, index.num_starts, 40)
    _, fine = points_seen_from_starts(index, starts, 64, 512, 0.5)
    directions = even_directions(512)
    for k, start in enumerate(starts):
        seen = fine.weights[k] > 0
        assert float(seen.float().mean()) > 0.3  # of a sparse scan, many pixels show no point
        relative = fine.positions[k][seen] - index.starts[start]
        cosine = (relative / relative.norm(dim=-1, keepdim=True) * directions[seen]).sum(-1)
        # A pixel of the view is 2.8 degrees high: the point kept for a direction lies in the same pixel.
        assert float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).max()) < 5
        for found, wanted in zip(project(relative, 64, 128), project(directions[seen], 64, 128), strict=True):
            assert torch.equal(found.long(), wanted.long())


def test_both_resolutions_show_the_same_points_in_nearly_the_same_colours() -> None:
    index = map_of(BOX)
    coarse, fine = points_seen_from_starts(index, torch.tensor([3, 1]), 64, 512, 0.0)
    assert torch.equal(coarse.positions, fine.positions)
    assert torch.equal(coarse.weights, fine.weights)
    assert 0 < float((coarse.colors - fine.colors).abs().mean()) < 0.2
    swapped = points_seen_from_starts(index, torch.tensor([1, 3]), 64, 512, 0.0)[1]
    torch.testing.assert_close(swapped.colors.flip(0), fine.colors)
