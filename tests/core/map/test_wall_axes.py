"""The axes that walls are built along, and how thick surfaces are."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.map.wall_axes import surface_thickness, wall_axes
from tests.core.painted_box import PaintedBox


def turned(positions: Tensor, degrees: float) -> Tensor:
    a = math.radians(degrees)
    about = torch.tensor([[math.cos(a), -math.sin(a), 0.0], [math.sin(a), math.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return positions @ about.T


def box_points() -> Tensor:
    return torch.from_numpy(np.asarray(PaintedBox(seed=3).scan().positions)).float()


@pytest.mark.parametrize("degrees", [0.0, 0.4, 17.0, 44.9, 61.0, 89.7])
def test_the_walls_of_a_turned_box_are_along_the_axes(degrees: float) -> None:
    axes = wall_axes(turned(box_points(), degrees))
    wall = turned(torch.tensor([[1.0, 0.0, 0.0]]), degrees)[0]
    along = (axes @ wall).abs().max()
    assert math.degrees(math.acos(min(1.0, float(along)))) < 0.3
    torch.testing.assert_close(axes @ axes.T, torch.eye(3), atol=1e-5, rtol=0)
    assert axes[2].tolist() == [0.0, 0.0, 1.0]


def test_a_floor_alone_has_no_walls() -> None:
    rng = np.random.default_rng(0)
    floor = np.stack((*rng.uniform(0, 5, (2, 20_000)), np.zeros(20_000)), axis=-1)
    assert torch.equal(wall_axes(torch.from_numpy(floor).float()), torch.eye(3))


def test_few_points_have_no_walls() -> None:
    assert torch.equal(wall_axes(torch.rand(3, 3)), torch.eye(3))
    assert surface_thickness(torch.rand(3, 3)) == 0.0


# How thick surfaces are.


def wall(apart_m: float, noise_m: float) -> Tensor:
    """Return a wall as two stations see it that are `apart_m` apart across it, turned out of the axes."""
    rng = np.random.default_rng(0)
    along, station = rng.uniform(0, 4, (2, 40_000)), rng.integers(0, 2, 40_000)
    across = noise_m * rng.normal(size=40_000) + apart_m * station
    return turned(torch.from_numpy(np.stack((across, *along), axis=-1)).float(), 30.0)


@pytest.mark.parametrize(("apart_m", "noise_m"), [(0.0, 0.004), (0.0, 0.02), (0.04, 0.003)])
def test_surfaces_are_as_thick_as_noise_and_stations_that_do_not_fit_make_them(apart_m: float, noise_m: float) -> None:
    found = surface_thickness(wall(apart_m, noise_m))
    assert found == pytest.approx(math.hypot(noise_m, apart_m / 2), rel=0.15)


def test_exact_surfaces_have_no_thickness_and_what_is_no_surface_is_not_asked() -> None:
    exact = wall(0.0, 0.0)
    assert surface_thickness(exact) < 1e-4
    hedge = 2 * torch.rand((40_000, 3), generator=torch.Generator().manual_seed(0)) - 5
    assert surface_thickness(torch.cat((exact, hedge))) < 1e-4
