"""What is masked is nothing, also not black."""

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.panorama.panorama import Panorama
from tests.core.found_pose import assert_found


def masked(panorama: Panorama, ignored: np.ndarray, repaint: int | None = None) -> Panorama:
    color = panorama.color.copy()
    if repaint is not None:
        color[ignored] = repaint
    return Panorama(color, panorama.valid & ~ignored)


@pytest.fixture(scope="module")
def right_half() -> np.ndarray:
    ignored = np.zeros((256, 512), bool)
    ignored[:, 256:] = True
    return ignored


@pytest.mark.slow
def test_a_panorama_masked_by_half_is_still_found_and_what_is_under_the_mask_has_no_influence(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama, box_pose: Pose, right_half: np.ndarray
) -> None:
    found = localizer.localize(masked(box_panorama, right_half), [box_index])
    assert found.status == "localized"
    assert_found(found, box_pose)
    for repaint in (0, 255):
        again = localizer.localize(masked(box_panorama, right_half, repaint), [box_index])
        assert found.best is not None
        assert again.best is not None
        np.testing.assert_array_equal(again.best.pose.matrix, found.best.pose.matrix)
        assert again.best.confidence == found.best.confidence


@pytest.mark.slow
def test_black_pixels_count_unless_they_are_masked(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama
) -> None:
    # The same black area: as a colour it is a change, under a mask it is nothing at all.
    area = np.zeros((256, 512), bool)
    area[90:170, 60:260] = True
    black = box_panorama.color.copy()
    black[area] = 0
    seen = localizer.localize(Panorama(black, np.ones_like(area)), [box_index])
    ignored = localizer.localize(Panorama(black, ~area), [box_index])
    assert seen.panorama_changed_fraction is not None
    assert ignored.panorama_changed_fraction is not None
    assert seen.panorama_changed_fraction > ignored.panorama_changed_fraction + 0.05
