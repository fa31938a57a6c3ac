"""Windows: parts of the image of a sphere, and the least one that holds some directions."""

import math

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles
from panoloc.core.geometry.sphere_window import CELLS, SphereWindow, directions_of, solid_angles_of, window_around

CPU = torch.device("cpu")
PART = SphereWindow(16, 4, 20, 8, 6)


def test_pixels_of_a_window_are_those_of_the_sphere() -> None:
    rows, columns = slice(4, 12), slice(20, 26)
    torch.testing.assert_close(directions_of(PART, CPU), pixel_directions(16, 32)[rows, columns].reshape(-1, 3))
    solid = pixel_solid_angles(16, 32).expand(-1, 32)[rows, columns]
    torch.testing.assert_close(solid_angles_of(PART, CPU), solid.flatten())


def test_a_direction_falls_into_its_own_pixel_and_nothing_outside_into_any() -> None:
    numbers, inside = PART.pixels_towards(directions_of(PART, CPU))
    assert bool(inside.all())
    np.testing.assert_array_equal(numbers, np.arange(48))
    everywhere = pixel_directions(16, 32).view(-1, 3)
    assert int(PART.pixels_towards(everywhere)[1].sum()) == 48


def test_an_image_of_a_part_lies_on_the_sphere_where_the_part_does() -> None:
    image = torch.rand((2, 48, 3))
    whole = PART.on_sphere(image, -1.0).view(2, 16, 32, 3)
    torch.testing.assert_close(whole[:, 4:12, 20:26].reshape(2, 48, 3), image)
    assert int((whole == -1.0).sum()) == 2 * 3 * (16 * 32 - 48)


@given(
    middle=st.floats(-math.pi, math.pi),
    spread=st.floats(0.01, math.pi),
    tilt=st.floats(-1.2, 1.2),
    margin=st.floats(0.0, 0.6),
    seed=st.integers(0, 100),
)
def test_the_window_around_directions_holds_them_and_their_margin(
    middle: float, spread: float, tilt: float, margin: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    azimuths = torch.from_numpy(middle + rng.uniform(-spread, spread, 20)).float()
    elevations = torch.from_numpy(np.clip(tilt + rng.uniform(-0.3, 0.3, 20), -1.5, 1.5)).float()
    turn, window = window_around(azimuths, elevations, margin)
    flat = elevations.cos()
    directions = torch.stack((flat * azimuths.cos(), flat * azimuths.sin(), elevations.sin()), dim=-1)
    other = torch.from_numpy(rng.normal(size=(20, 3))).float()
    across = torch.nn.functional.normalize(torch.linalg.cross(directions, other), dim=-1)
    moved = directions * math.cos(margin) + across * math.sin(margin)
    for each in (directions, moved):
        assert bool(window.at(64).pixels_towards(_turned(each, -turn))[1].all())


def test_what_reaches_over_a_pole_takes_all_columns() -> None:
    _, window = window_around(torch.tensor([0.3]), torch.tensor([1.5]), 0.2)
    assert window.is_round
    assert window.first_row == 0
    assert window.height < CELLS


def _turned(directions: torch.Tensor, angle: float) -> torch.Tensor:
    cosine, sine = math.cos(angle), math.sin(angle)
    return directions @ torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]).T
