"""Rooms have about as many starts as asked for."""

import pytest
import torch

from core.config import StartsConfig
from core.index.starts import octree_starts
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.rooms import Rooms, spacing_for


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [20, 100, 400])
def test_the_spacing_puts_about_as_many_starts_into_a_room(wanted: int) -> None:
    cloud = PaintedRoom(0).scan(20_000)
    found = octree_starts(cloud.positions, StartsConfig(spacing_m=spacing_for(cloud, wanted), max_starts=10_000))
    assert 0.7 * wanted <= len(found) <= 1.3 * wanted


@pytest.mark.slow
def test_a_room_is_made_once_and_said() -> None:
    said: list[str] = []
    rooms = Rooms(torch.device("cpu"), said.append)
    first = rooms.indexed(0, 3_000, 6)
    assert rooms.indexed(0, 3_000, 6) is first
    assert rooms.indexed(1, 3_000, 6) is not first
    assert said == ["making a room: 3,000 points, about 6 starts"] * 2
    assert first.index.num_points == 3_000
