"""The rounds of search: what is searched first, what is looked at first, and what else looks like a pose that was found."""

import math
from dataclasses import replace

import pytest

from panoloc.core.camera.rig import Rig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.query.rounds import aliases_of_pose, propose, rounds_of
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, OTHER_BOX, POSE, SYMMETRIC, TWIN, map_of, tensors_of
from tests.core.image.painted_photos import UPRIGHT, photo_of
from tests.core.painted_box import PaintedBox
from tests.core.search.found_candidates import CONFIG, RIGS, query, query_of

pytestmark = pytest.mark.slow
SEARCH = CONFIG.search
_ROTATION, _POSITION = tensors_of(POSE)
FOUND = Hypothesis(0, 0, _ROTATION[0], _POSITION[0])


def queries_of(*maps: MapIndex, hints: Hints | None = None) -> list[MapQuery]:
    return prepare_queries(Rig.of_photo(photo_of(UPRIGHT)), maps, hints, CONFIG)


def pose_of(hypothesis: Hypothesis) -> Pose:
    return Pose(hypothesis.rotation.double().numpy(), hypothesis.position.double().numpy())


@pytest.mark.parametrize(
    ("labels", "most_tilt_deg", "by_lines", "is_level_first"),
    [
        (False, None, [True, True, False], True),
        (False, 10.0, [True, False], False),  # narrower than level poses as they are
        (True, None, [False, False], True),  # labels have no lines to ask
        (True, 10.0, [False], False),
    ],
)
def test_photos_that_may_be_tilted_are_searched_level_first_and_by_lines_before_all_is_searched(
    labels: bool, most_tilt_deg: float | None, by_lines: list[bool], is_level_first: bool
) -> None:
    index = map_of(LABELLED, AS_LABELS) if labels else map_of(OTHER_BOX)
    (photo,) = queries_of(index, hints=Hints(max_tilt_deg=most_tilt_deg) if most_tilt_deg else None)
    rounds = list(rounds_of([photo], SEARCH))
    assert [each.by_lines for each in rounds] == by_lines
    level = replace(photo.limits, max_tilt=math.radians(SEARCH.level_tilt_deg))
    assert rounds[0].limits == [level if is_level_first else photo.limits]
    assert all(each.limits == [photo.limits] for each in rounds[1:])


@pytest.mark.parametrize(
    ("max_tilt_deg", "by_lines"),
    [(None, [False, True, True]), (10.0, [False, True])],
)
def test_of_panoramas_all_is_searched_at_once_and_lines_are_asked_only_after_that(
    max_tilt_deg: float | None, by_lines: list[bool]
) -> None:
    panorama = query_of(RIGS["panorama"][0], Hints(max_tilt_deg=max_tilt_deg) if max_tilt_deg else None)
    rounds = rounds_of([panorama], SEARCH)
    first = next(rounds)
    propose([panorama], first, SEARCH)
    assert "lines" not in vars(panorama)  # most queries never pay for them
    rest = list(rounds)
    assert [each.by_lines for each in (first, *rest)] == by_lines
    level = replace(panorama.limits, max_tilt=math.radians(SEARCH.level_tilt_deg))
    assert [each.limits for each in rest] == [[level], [panorama.limits]][-len(rest) :]


def test_of_panoramas_of_labels_all_is_searched_and_nothing_else() -> None:
    panorama = prepare_queries(RIGS["panorama"][0], [map_of(LABELLED, AS_LABELS)], None, CONFIG)
    assert [each.by_lines for each in rounds_of(panorama, SEARCH)] == [False]


def test_the_best_are_looked_at_first() -> None:
    (first, rest), *_ = propose([query("one photo")], next(rounds_of([query("one photo")], SEARCH)), SEARCH)
    assert len(first) == SEARCH.num_candidates // 4
    assert 0 < len(rest) <= SEARCH.num_candidates - len(first)
    assert all(h is not other for h in first for other in rest)


# Aliases.


def test_the_other_side_of_a_symmetric_room_is_an_alias_and_the_place_itself_is_not() -> None:
    found = aliases_of_pose(queries_of(map_of(SYMMETRIC)), FOUND)
    assert 0 < len(found) <= CONFIG.aliases.most
    assert pose_error(pose_of(found[0]), TWIN).within(0.75, 15.0)
    assert not any(pose_error(pose_of(h), POSE).within(1.0, 45.0) for h in found)


def test_an_alias_is_as_far_beside_its_start_as_the_pose_beside_its_own_turned_with_it() -> None:
    index = map_of(SYMMETRIC)
    off = float((index.starts - FOUND.position).norm(dim=1).min())
    (best, *_) = aliases_of_pose(queries_of(index), FOUND)
    assert off > 0.1
    # The starts of a symmetric room lie opposite each other.
    assert pose_error(pose_of(best), TWIN).within(0.02, 0.5)


def test_a_room_that_looks_like_no_other_has_no_aliases() -> None:
    assert aliases_of_pose(queries_of(map_of(OTHER_BOX)), FOUND) == []
    found = aliases_of_pose(queries_of(map_of(SYMMETRIC), map_of(OTHER_BOX)), FOUND)
    assert {h.map_number for h in found} == {0}


@pytest.mark.parametrize(("box", "least", "most"), [(SYMMETRIC, 1.0, 1.0), (BOX, 0.0, 0.03), (OTHER_BOX, 0.0, 0.03)])
def test_hardly_a_start_of_a_plain_room_has_aliases_and_every_one_of_a_symmetric_room(
    box: PaintedBox, least: float, most: float
) -> None:
    # The view along a wall hardly changes over the metre and a half from which on places are others.
    share = float((map_of(box).aliases.starts >= 0).any(1).float().mean())
    assert least <= share <= most


def test_the_same_room_in_another_map_is_an_alias_on_both_sides() -> None:
    index = map_of(SYMMETRIC)
    again = replace(index, views=replace(index.views))  # registered a second time
    found = [h for h in aliases_of_pose(queries_of(index, again), FOUND) if h.map_number == 1]
    for pose in (POSE, TWIN):
        assert any(pose_error(pose_of(h), pose).within(0.75, 15.0) for h in found)


def test_no_alias_is_beyond_the_hints() -> None:
    heading = math.degrees(POSE.yaw_pitch_roll[0])
    hints = Hints(heading_deg=heading, heading_tolerance_deg=40.0)
    assert aliases_of_pose(queries_of(map_of(SYMMETRIC), hints=hints), FOUND) == []


def test_maps_share_the_rig_where_their_colours_mean_the_same() -> None:
    colored, labelled = map_of(BOX), map_of(LABELLED, AS_LABELS)
    codes = labelled.labels
    assert codes is not None
    again = replace(labelled, labels=LabelCodes(codes.labels.clone(), codes.codes))
    fewer = replace(labelled, labels=LabelCodes(codes.labels[1:], codes.codes[1:]))
    rigs = [each.rig for each in queries_of(colored, labelled, again, fewer, map_of(OTHER_BOX))]
    assert [rigs.index(rig) for rig in rigs] == [0, 1, 1, 3, 0]
