"""A query made ready for a map: where its poses may end."""

from dataclasses import replace

import numpy as np
import torch

from core.config import LocalizerConfig
from core.geometry.pose import Pose
from core.geometry.rotations import rotation_angle, rotation_from_vector
from core.index.map_index import MapIndex
from core.judge.hypotheses import Hypothesis
from core.options import Hints
from core.prepared_query import MapQuery, prepare_queries
from tests.core.painted_box import PaintedBox


def prepared(box: PaintedBox, index: MapIndex, hints: Hints | None = None) -> MapQuery:
    panorama = box.panorama(Pose(np.eye(3), np.array([0.3, 0.2, 1.2])), 64)
    (query,) = prepare_queries(panorama, [index], hints, 64, LocalizerConfig())
    return query


def at(index: MapIndex, above_m: float) -> Hypothesis:
    """Return a pose in the middle of the box, or so much above the highest start."""
    middle = (index.starts.amin(0) + index.starts.amax(0)) / 2
    if above_m:
        middle[2] = index.starts[:, 2].max() + above_m
    return Hypothesis(0, 0, torch.eye(3), middle)


def test_a_pose_outside_of_the_room_is_none_unless_a_hint_names_the_place(box: PaintedBox, box_index: MapIndex) -> None:
    query = prepared(box, box_index)
    assert query.allows(at(box_index, 0.0))
    assert query.allows(at(box_index, 0.7))
    assert not query.allows(at(box_index, 2.0))
    there = at(box_index, 2.0)
    x, y, z = (there.position.double().numpy() + box_index.origin_offset).tolist()
    assert prepared(box, box_index, Hints(position_m=(x, y, z), radius_m=0.5)).allows(there)


def test_a_pose_that_tilts_more_than_hints_allow_is_turned_back_and_others_are_left(
    box: PaintedBox, box_index: MapIndex
) -> None:
    tilted = replace(at(box_index, 0.0), rotation=rotation_from_vector(torch.tensor([0.0, 0.5, 0.0])))
    free, bound = prepared(box, box_index), prepared(box, box_index, Hints(upright=True))
    assert free.within_limits(replace(tilted, is_held_back=True)) == tilted
    held = bound.within_limits(tilted)
    assert held.is_held_back
    assert float(rotation_angle(held.rotation, tilted.rotation)) > 0.2
    assert not bound.within_limits(at(box_index, 0.0)).is_held_back
