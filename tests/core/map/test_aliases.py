"""Perceptual aliasing, in boxes that stand somewhere else again, turned, and in boxes that look like no other place."""

import math
from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from panoloc.core.config import DISTANCES, AliasConfig
from panoloc.core.features.patch_descriptors import DescribedPatches, patch_scores
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.aliases import _scores, aliases_in_another_map
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import IndexOptions
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.built_maps import BOX, COARSE, OTHER_BOX, SYMMETRIC, map_of
from tests.core.painted_box import PaintedBox, rotation_of

pytestmark = pytest.mark.slow
CONFIG = AliasConfig()
# Where the box stands a second time, a quarter turn to the left.
AGAIN = Pose(rotation_of(90.0), np.array([12.0, 1.0, 0.0]))
Array = NDArray[np.float64]


def scan_again() -> PointCloud:
    """Return another scan of the box, of other points, where it stands a second time."""
    scan = BOX.scan(12_000, seed=1)
    positions = (scan.positions @ AGAIN.rotation.T + AGAIN.position).astype(np.float32)
    return PointCloud(positions, scan.colors, num_points_read=len(positions))


@cache
def map_of_two_equal_rooms() -> MapIndex:
    here, there = BOX.scan(12_000), scan_again()
    positions, colors = np.concatenate((here.positions, there.positions)), np.concatenate((here.colors, there.colors))
    return build_map_index(PointCloud(positions, colors, num_points_read=24_000), IndexOptions(spacing_m=0.8))


@cache
def map_of_the_room_again() -> MapIndex:
    return build_map_index(scan_again(), IndexOptions(spacing_m=0.8))


def first_aliases(index: MapIndex) -> tuple[Array, Array, Array]:
    """Return the starts (T, 3) that have aliases, where the best alias of each is (T, 3), and the turn to it (T,) degrees."""
    starts, first = index.starts.double().numpy(), index.aliases.starts[:, 0].numpy()
    return (
        starts[first >= 0],
        starts[first[first >= 0]],
        np.degrees(index.aliases.turns[first >= 0, 0].double().numpy()),
    )


def test_views_turned_by_columns_of_patches_score_as_in_a_search() -> None:
    for own, others in ((map_of(BOX).views, map_of(BOX).views), (map_of(BOX).views, map_of(OTHER_BOX).views)):
        angles = torch.arange(16) * (2 * math.pi / 16)
        turns = rotation_from_vector(torch.nn.functional.pad(angles[:, None], (2, 0)))
        described, grid = own.descriptors(1), own.grid.halved(1)
        numbers = torch.tensor([5, 90])
        for number, scores in zip(numbers.tolist(), _scores(own, numbers, others), strict=True):
            along = described.values[number] @ own.basis.T @ others.basis
            patches = DescribedPatches(along, torch.arange(len(along)), described.weights[number], grid)
            torch.testing.assert_close(scores, patch_scores(patches, others.descriptors(1), turns), atol=1e-4, rtol=0)


def share_off_by(turns_deg: Array, expected_deg: Array | float) -> float:
    """Return the share of turns that are not the expected ones."""
    off = (turns_deg - expected_deg + 180) % 360 - 180
    return float((np.abs(off) > 1).mean())


def test_two_equal_rooms_alias_each_other_with_the_turn_between_them() -> None:
    starts, found, turns_deg = first_aliases(map_of_two_equal_rooms())
    assert len(starts) > 0.9 * map_of_two_equal_rooms().num_starts  # a few lie between the rooms
    is_first = starts[:, 0] < 6
    assert 0.3 < is_first.mean() < 0.7
    there, back = starts @ AGAIN.rotation.T + AGAIN.position, (starts - AGAIN.position) @ AGAIN.rotation
    off = np.linalg.norm(found - np.where(is_first[:, None], there, back), axis=1)
    assert np.median(off) < 0.48  # starts are 0.8 m apart
    assert np.mean(off < 1.2) > 0.95
    assert share_off_by(turns_deg, np.where(is_first, 90.0, 270.0)) < 0.05


def test_the_sides_of_a_symmetric_room_alias_each_other_after_half_a_turn() -> None:
    starts, found, turns_deg = first_aliases(map_of(SYMMETRIC))
    assert len(starts) == map_of(SYMMETRIC).num_starts
    other_side = np.array([*SYMMETRIC.size_m[:2], 0.0]) + starts * (-1, -1, 1)
    np.testing.assert_allclose(found, other_side, atol=0.01)
    assert share_off_by(turns_deg, 180.0) == 0


def test_no_place_is_an_alias_of_itself_and_those_of_a_start_are_different_places() -> None:
    for index in (map_of(SYMMETRIC), map_of_two_equal_rooms()):
        for number, (others, turns) in enumerate(
            zip(index.aliases.starts.tolist(), index.aliases.turns.tolist(), strict=True)
        ):
            kept = [(index.starts[k], math.degrees(turn)) for k, turn in zip(others, turns, strict=True) if k >= 0]
            assert len(kept) == len(others) or others[len(kept) :] == [-1] * (len(others) - len(kept))
            for place, turn in kept:
                is_turned = min(turn, 360 - turn) > DISTANCES.elsewhere.angle_deg
                assert is_turned or float((place - index.starts[number]).norm()) >= DISTANCES.elsewhere.distance_m
            for k, (place, turn) in enumerate(kept):
                for other, other_turn in kept[:k]:
                    between = abs((turn - other_turn + 180) % 360 - 180)
                    far = float((place - other).norm()) >= DISTANCES.elsewhere.distance_m
                    assert far or between >= DISTANCES.elsewhere.angle_deg - 0.1


@pytest.mark.parametrize(
    ("box", "options"), [(OTHER_BOX, IndexOptions()), (BOX, COARSE), (BOX, IndexOptions(spacing_m=2.0))]
)
def test_hardly_any_start_of_a_single_room_has_one_however_far_apart_starts_are(
    box: PaintedBox, options: IndexOptions
) -> None:
    index = map_of(box, options)
    assert float((index.aliases.starts[:, 0] >= 0).float().mean()) < 0.06


# Of another map.


def in_another_map(index: MapIndex, number: int) -> tuple[Array, Array]:
    """Return where in another map it looks as in that of BOX from a start, places (A, 3) and turns (A,) degrees."""
    own = map_of(BOX)
    starts, turns = aliases_in_another_map(own.views, number, index.views.to("cpu"), index.starts, CONFIG)
    assert len(starts) <= CONFIG.most
    return index.starts[starts].double().numpy(), np.degrees(turns.double().numpy())


NUMBERS = range(0, 252, 21)


def test_the_same_room_in_another_map_is_found() -> None:
    off, turns_deg = [], []
    for number in NUMBERS:
        places, turns = in_another_map(map_of_the_room_again(), number)
        there = AGAIN.rotation @ map_of(BOX).starts[number].double().numpy() + AGAIN.position
        off.append(np.linalg.norm(places[0] - there))
        turns_deg.append(turns[0])
    assert np.median(off) < 0.6
    assert max(off) < 1.2
    assert share_off_by(np.array(turns_deg), 90.0) < 0.1


def test_in_a_map_of_another_room_nothing_is() -> None:
    assert all(len(in_another_map(map_of(OTHER_BOX), number)[0]) == 0 for number in NUMBERS)


def test_a_map_that_is_equal_has_the_place_itself() -> None:
    for number in NUMBERS:
        places, turns_deg = in_another_map(map_of(BOX), number)
        np.testing.assert_array_equal(places[0], map_of(BOX).starts[number].double().numpy())
        assert turns_deg[0] == 0
