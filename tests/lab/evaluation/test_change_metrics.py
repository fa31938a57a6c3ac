"""Average precision of change maps: matched to the index's order of points, on the pixels and points that are scored."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.rig import Rig
from panoloc.core.geometry.pose import Pose
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization, SearchSummary
from panoloc.lab.evaluation.known_cases import KnownQuery
from panoloc.lab.evaluation.metrics import change_metrics, points_of_index
from tests.core.painted_box import PaintedBox

EMPTY = Localization("localized", SearchSummary("fast", 1, 1, 1, 1), {})


def test_flags_follow_their_points_into_the_order_of_the_index(box: PaintedBox, box_index: MapIndex) -> None:
    cloud = box.scan()
    in_left_half = cloud.positions[:, 0] < 2.5
    found = points_of_index(in_left_half, cloud.positions, box_index.positions.numpy())
    assert np.array_equal(found, box_index.positions.numpy()[:, 0] < 2.5)
    assert not np.array_equal(found, in_left_half)  # or the test would say nothing


def _query(box: PaintedBox, box_pose: Pose, box_index: MapIndex) -> KnownQuery:
    panorama = box.panorama(box_pose, 64)
    pixels = np.zeros((64, 128), bool)
    pixels[24:40, 30:60] = True
    return KnownQuery(Rig.of_panorama(panorama), (box_pose,), pixels, box.scan().positions[:, 0] < 1.0)


def _scored(query: KnownQuery, box_index: MapIndex, truthful: bool) -> Localization:
    """Return an answer whose maps are the truth, or its opposite."""
    assert query.changed_pixels is not None
    pixels = query.changed_pixels[::2, ::2]
    points = box_index.positions.numpy()[:, 0] < 1.0
    flat, solid = (np.where(part == truthful, 0.1, 0.9).astype(np.float32) for part in (pixels, points))
    return replace(EMPTY, score_pixels=lambda: flat, score_points=lambda: solid)


def test_maps_that_are_the_truth_have_precision_one_and_their_opposite_what_no_knowledge_reaches(
    box: PaintedBox, box_pose: Pose, box_index: MapIndex
) -> None:
    query = _query(box, box_pose, box_index)
    right, wrong = (
        change_metrics(query, box.scan(), box_index, _scored(query, box_index, truthful)) for truthful in (True, False)
    )
    assert (right["ap_2d"], right["ap_3d"]) == pytest.approx((1.0, 1.0))
    assert wrong["ap_2d"] == pytest.approx(wrong["changed_pixels"])
    assert wrong["ap_3d"] == pytest.approx(wrong["changed_points"])


def test_what_has_no_score_is_not_compared(box: PaintedBox, box_pose: Pose, box_index: MapIndex) -> None:
    query = _query(box, box_pose, box_index)
    answer = _scored(query, box_index, False)
    assert answer.score_map_2d is not None
    assert answer.point_scores is not None
    assert query.changed_pixels is not None
    wrong_pixels, wrong_points = answer.score_map_2d.copy(), answer.point_scores.copy()
    wrong_pixels[query.changed_pixels[::2, ::2]] = np.nan
    wrong_points[:] = np.nan
    found = change_metrics(
        query,
        box.scan(),
        box_index,
        replace(answer, score_pixels=lambda: wrong_pixels, score_points=lambda: wrong_points),
    )
    assert found == {}  # nothing that changed is scored, so there is no precision
