"""What is said of an object that changed."""

from datetime import UTC, datetime

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama
from panoloc.core.changes.__main__ import object_document
from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.finding import Change, DatedPhoto
from panoloc.core.geometry.pose import Pose

NOTHING_SEEN = Panorama(np.zeros((2, 4, 3), np.uint8), np.zeros((2, 4), np.bool_))


def photo(day: int, x: float) -> DatedPhoto:
    return DatedPhoto(NOTHING_SEEN, Pose(np.eye(3), np.array([x, 0.0, 1.6])), datetime(2026, 11, day, tzinfo=UTC))


@pytest.mark.parametrize(("over", "is_sure"), [(0.01, True), (-0.01, False)])
def test_only_what_is_likely_enough_is_stated(over: float, is_sure: bool) -> None:
    change = Change("0123456789ab", "went", np.zeros(3), np.ones(3), None, CHANGES.sure + over, (0,))
    assert object_document(change, [photo(1, 0.0)])["is_sure"] is is_sure


def test_it_was_seen_from_its_best_photo_between_the_first_and_the_last() -> None:
    change = Change("0123456789ab", "moved", np.zeros(3), np.ones(3), np.array([1.0, 2.0, 0.0]), 0.9, (2, 0))
    document = object_document(change, [photo(7, 1.0), photo(1, 2.0), photo(5, 3.0)])
    assert (document["num_photos"], document["seen_from_m"], document["from_m"]) == (
        2,
        [3.0, 0.0, 1.6],
        [1.0, 2.0, 0.0],
    )
    assert (document["first_seen_at"], document["last_seen_at"]) == ("2026-11-05T00:00:00Z", "2026-11-07T00:00:00Z")
