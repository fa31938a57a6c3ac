"""Floors and ceilings in scans of rooms whose heights are known."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.scan.storeys import Floor, floors_of
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene

POINTS = 40_000


@cache
def scanned(kind: str, seed: int) -> NDArray[np.float64]:
    """Return the points of a procedural scene, whose floor is at 0."""
    return scan_scene(build_scene(SceneSpec(kind, seed)), num_points=POINTS, seed=seed).positions.astype(np.float64)  # type: ignore[arg-type]


def outer_height(positions: NDArray[np.float64]) -> float:
    """Return the height of nearly all points: that of the ceiling of a room."""
    return float(np.quantile(positions[:, 2], 0.98))


@pytest.mark.parametrize(("kind", "seed"), [("room", 106), ("room", 107), ("bare", 104), ("flat", 105)])
def test_a_storey_has_one_floor_however_many_tables_stand_on_it(kind: str, seed: int) -> None:
    positions = scanned(kind, seed)
    (floor,) = floors_of(positions)
    assert floor.level_m == pytest.approx(0, abs=0.05)
    assert floor.height_m == pytest.approx(outer_height(positions), abs=0.08)


def test_storeys_above_each_other_are_told_apart() -> None:
    below, above = scanned("room", 106), scanned("room", 107)
    level = outer_height(below) + 0.35
    lower, upper = floors_of(np.concatenate([below + np.array([0, 0, 20]), above + np.array([0, 0, 20 + level])]))
    assert [lower.level_m, upper.level_m] == pytest.approx([20, 20 + level], abs=0.12)
    heights = outer_height(below), outer_height(above)
    assert (lower.height_m, upper.height_m) == pytest.approx(heights, abs=0.15)


def test_a_place_without_a_ceiling_has_a_floor_without_height_at_most() -> None:
    positions = scanned("room", 106)
    (floor,) = floors_of(positions[positions[:, 2] < 2.0])
    assert floor == Floor(floor.level_m, None)
    assert floors_of(np.random.default_rng(0).random((5000, 3))) == []
    assert floors_of(np.zeros((2, 3))) == []
