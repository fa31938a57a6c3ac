"""Panoramas with defects that nobody told of, and with perfect masks."""

from dataclasses import replace

import numpy as np
import pytest

from core.panorama.panorama import Panorama
from lab.evaluation.photo_source import as_uploaded
from lab.rooms import View, make_case, suite_of, with_any_defect


def test_what_is_not_covered_by_a_defect_stays_but_for_compression(room_view: View) -> None:
    kinds = set()
    for seed in range(12):
        panorama, covered = with_any_defect(room_view.panorama, np.random.default_rng(seed))
        assert panorama.valid.all()
        assert 0.01 < covered.mean() < 0.75
        difference = np.abs(panorama.color.astype(int) - room_view.panorama.color).mean(-1)
        assert np.median(difference[~covered]) < 4
        kinds.add(round(float(covered.mean()), 3))
    assert len(kinds) > 6


@pytest.mark.slow
def test_the_same_panorama_comes_with_and_without_a_perfect_mask() -> None:
    cases = []
    for name in ("rooms/void", "rooms/void_masked"):
        suite, camera = suite_of(name)
        cases.append(make_case(name, replace(suite, num_points=3000), 2, width=256, camera=camera))
    untold, masked = cases
    assert untold.missing_pixels is not None
    np.testing.assert_array_equal(untold.panorama.color, masked.panorama.color)
    assert untold.panorama.valid.all()
    np.testing.assert_array_equal(masked.panorama.valid, ~untold.missing_pixels)


def test_a_panorama_is_read_as_an_upload_without_losing_its_own_mask(room_view: View) -> None:
    valid = np.ones((256, 512), bool)
    valid[:, :100] = False
    read = as_uploaded(Panorama(room_view.panorama.color, valid))
    assert not read.valid[:, :100].any()
    np.testing.assert_array_equal(read.color, room_view.panorama.color)
