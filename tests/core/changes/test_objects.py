"""Peaks of middles are objects; what went and came again moved."""

import numpy as np
import pytest
import torch

from panoloc.core.changes.network import CELL, OUTPUTS
from panoloc.core.changes.objects import PlacedObject, certainty_of, pair_up, placed_objects, without_repeats
from panoloc.core.changes.voxels import NUM_FEATURES, VoxelGrid

GRID = VoxelGrid(np.zeros(3), (24, 24, 16), 0.1)
WHOLE = tuple(slice(0, count) for count in GRID.shape)


def said_of(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> torch.Tensor:
    """Return what a network would say that knows middles and sides of boxes."""
    cells = VoxelGrid(GRID.low, (12, 12, 8), CELL * GRID.side)
    centers = cells.centers().view(*cells.shape, 3)
    said = torch.full((OUTPUTS, *cells.shape), -5.0)
    for middle, sides in boxes:
        way = torch.tensor(middle) - centers
        here = way.norm(dim=-1) < 0.3
        said[0] = torch.where(here, 3 - 10 * way.norm(dim=-1), said[0])
        said[1] = torch.where((way.abs() < torch.tensor(sides) / 2).all(-1), 3.0, said[1])
        said[2:5] = torch.where(here, way.movedim(-1, 0), said[2:5])
        said[5:] = torch.where(here, torch.tensor(sides).log().view(3, 1, 1, 1), said[5:])
    return said


def thing(
    center: tuple[float, float, float],
    size: tuple[float, float, float],
    color: float = 0.5,
    is_new: bool = True,
    certainty: float = 0.9,
) -> PlacedObject:
    middle, half = np.array(center), np.array(size) / 2
    return PlacedObject(is_new, middle - half, middle + half, middle[None], certainty, np.full(3, color))


def test_two_cupboards_that_touch_are_two_objects() -> None:
    size = (0.8, 0.6, 1.0)
    said = said_of(((0.7, 1.1, 0.5), size), ((1.5, 1.1, 0.5), size))
    found = placed_objects(said, torch.zeros(NUM_FEATURES, *GRID.shape), GRID, WHOLE, is_new=True)
    assert [each.center for each in found] == [pytest.approx((x, 1.1, 0.5), abs=1e-3) for x in (0.7, 1.5)]
    assert found[0].size == pytest.approx(size, abs=1e-3)
    assert np.abs(found[0].voxels - found[0].center).max(0) == pytest.approx(np.array(size) / 2, abs=0.1)


def test_each_of_two_tiles_has_the_objects_whose_middle_it_holds() -> None:
    said = said_of(((0.7, 1.1, 0.5), (0.8, 0.6, 1.0)))
    left, right = ((slice(a, b), *WHOLE[1:]) for a, b in ((0, 8), (8, 24)))
    features = torch.zeros(NUM_FEATURES, *GRID.shape)
    assert [len(placed_objects(said, features, GRID, part, is_new=True)) for part in (left, right)] == [1, 0]


def test_a_thing_that_is_found_twice_is_listed_once_and_what_stood_in_its_place_as_well() -> None:
    rug, again = thing((0, 0, 0), (2.4, 1.6, 0.1)), thing((0.4, 0, 0), (1.2, 1.6, 0.1), certainty=0.5)
    former = thing((0, 0, 0), (2.4, 1.6, 0.1), is_new=False, certainty=0.4)
    assert without_repeats([again, rug, former]) == [rug, former]


def test_what_went_and_came_moved_where_size_and_colour_agree_even_turned() -> None:
    went = [thing((0, 0, 0.4), (1.6, 0.8, 0.8), 0.3, False), thing((2, 0, 1.0), (0.5, 0.5, 2.0), 0.7, False)]
    came = [thing((3, 3, 0.4), (0.8, 1.6, 0.8), 0.32, True), thing((1, 1, 0.4), (1.6, 0.8, 0.8), 0.9, True)]
    assert pair_up(went, came) == [(0, 0)]


def test_what_surely_went_is_not_paired_with_what_perhaps_came() -> None:
    went = [thing((0, 0, 0.4), (1.6, 0.8, 0.8), is_new=False)]
    assert pair_up(went, [thing((3, 3, 0.4), (1.6, 0.8, 0.8))]) == [(0, 0)]
    assert pair_up(went, [thing((3, 3, 0.4), (1.6, 0.8, 0.8), certainty=0.2)]) == []


def test_stronger_evidence_makes_surer() -> None:
    found = [certainty_of(likelihood) for likelihood in (0.3, 0.5, 0.8, 1.0)]
    assert found[:3] == sorted(set(found[:3]))
    assert 0 < found[0] < found[-1] < 1
