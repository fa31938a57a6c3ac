"""Voxels that vote for the same middle are one object; what went and came again moved."""

import numpy as np
import pytest

from panoloc.core.changes.finding import certainty_of
from panoloc.core.changes.objects import LikelyVoxels, PlacedObject, pair_up, placed_objects


def block(center: tuple[float, float, float], size: tuple[float, float, float], is_new: bool = True) -> LikelyVoxels:
    """Return the voxels of a box, with votes that are up to 8 cm off."""
    axes = [np.arange(c - s / 2 + 0.05, c + s / 2, 0.1) for c, s in zip(center, size, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    votes = np.array(center) + np.random.default_rng(0).uniform(-0.08, 0.08, centers.shape)
    return LikelyVoxels(is_new, centers, votes, np.full(len(centers), 0.9), np.full((len(centers), 3), 0.5))


def thing(
    center: tuple[float, float, float], size: tuple[float, float, float], color: float, is_new: bool
) -> PlacedObject:
    middle, half = np.array(center), np.array(size) / 2
    return PlacedObject(is_new, middle - half, middle + half, middle[None], 0.9, np.full(3, color))


def test_two_cupboards_that_touch_are_two_objects() -> None:
    parts = [block((0.0, 0.0, 0.5), (0.8, 0.6, 1.0)), block((0.8, 0.0, 0.5), (0.8, 0.6, 1.0))]
    found = sorted(placed_objects(parts), key=lambda each: each.center[0])
    assert [each.center for each in found] == [pytest.approx((x, 0, 0.5), abs=0.05) for x in (0.0, 0.8)]
    assert found[0].size == pytest.approx((0.8, 0.6, 1.0), abs=0.12)


def test_an_object_of_two_tiles_is_one() -> None:
    whole = block((0.0, 0.0, 0.5), (1.6, 0.6, 1.0))
    left = whole.centers[:, 0] < 0.1
    halves = [
        LikelyVoxels(True, whole.centers[m], whole.middles[m], whole.likelihood[m], whole.colors[m])
        for m in (left, ~left)
    ]
    (found,) = placed_objects(halves)
    assert found.center == pytest.approx((0, 0, 0.5), abs=0.05)


def test_a_few_stray_voxels_are_no_object() -> None:
    stray = LikelyVoxels(True, np.zeros((2, 3)), np.zeros((2, 3)), np.full(2, 0.6), np.zeros((2, 3)))
    assert placed_objects([stray]) == placed_objects([]) == []


def test_what_went_and_came_moved_where_size_and_colour_agree_even_turned() -> None:
    went = [thing((0, 0, 0.4), (1.6, 0.8, 0.8), 0.3, False), thing((2, 0, 1.0), (0.5, 0.5, 2.0), 0.7, False)]
    came = [thing((3, 3, 0.4), (0.8, 1.6, 0.8), 0.32, True), thing((1, 1, 0.4), (1.6, 0.8, 0.8), 0.9, True)]
    assert pair_up(went, came) == [(0, 0)]


def test_more_photos_and_stronger_evidence_make_surer() -> None:
    by_photos = [certainty_of(0.8, count, 50) for count in (1, 2, 3)]
    by_likelihood = [certainty_of(share, 2, 50) for share in (0.5, 0.7, 0.9)]
    assert by_photos == sorted(set(by_photos))
    assert by_likelihood == sorted(set(by_likelihood))
