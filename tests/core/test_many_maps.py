"""A panorama in one of many maps, of which few are loaded."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from panoloc.core import many_maps
from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose
from panoloc.core.localizer import Localizer
from panoloc.core.many_maps import localize_among, scores_among, view_from
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import RetrievalVectors, retrieval_vectors
from panoloc.core.options import Status
from panoloc.core.results import Candidate, Localization, SearchSummary
from tests.core.built_maps import BOX, COARSE, OTHER_BOX, POSE, SYMMETRIC, localized, map_of, panorama, rig_of
from tests.core.found_pose import assert_found, best_of
from tests.core.image.painted_photos import SIDEWAYS, photo_of
from tests.core.painted_box import PaintedBox, rotation_of

UNKNOWN = PaintedBox(seed=8, size_m=(3.4, 5.2, 2.7))


@cache
def with_limits(first: int, most_maps: int) -> Localizer:
    """Return a localizer that looks at so many maps first, and at no more than that."""
    config = LocalizerConfig()
    return Localizer(
        replace(config, search=replace(config.search, num_candidates=8 * first, most_maps=most_maps)), "cpu"
    )


class Boxes:
    """Maps of boxes. asked: the numbers of the indexes that were asked for."""

    def __init__(self, *boxes: PaintedBox) -> None:
        self._boxes = boxes
        self.asked: list[int] = []

    def __len__(self) -> int:
        return len(self._boxes)

    def vectors(self) -> Sequence[RetrievalVectors]:
        return [retrieval_vectors(map_of(box)) for box in self._boxes]

    def indexes(self, numbers: Sequence[int]) -> Sequence[MapIndex]:
        self.asked += numbers
        return [map_of(self._boxes[number]) for number in numbers]


def among(boxes: Boxes, query: Panorama, first: int, most_maps: int) -> Localization:
    return localize_among(with_limits(first, most_maps), rig_of(query), boxes, timeout_s=60)


@pytest.mark.slow
def test_only_the_likeliest_map_is_loaded_where_it_is_the_right_one() -> None:
    boxes = Boxes(OTHER_BOX, SYMMETRIC, BOX)
    found = among(boxes, panorama(), 1, 3)
    assert boxes.asked == [2]
    assert best_of(found).map_position == 2
    assert found.search.num_maps == 3
    assert {"retrieval", "load", "search"} <= set(found.timings_s)
    assert_found(found, POSE)


@pytest.mark.slow
def test_maps_that_others_have_found_to_be_the_likeliest_are_searched_in_their_order() -> None:
    boxes = Boxes(OTHER_BOX, BOX, SYMMETRIC)
    found = localize_among(with_limits(1, 3), rig_of(panorama()), boxes, num_maps=40)
    assert boxes.asked[0] == 0
    assert (best_of(found).map_position, found.search.num_maps) == (1, 40)
    assert "retrieval" not in found.timings_s


@pytest.mark.slow
def test_scores_do_not_depend_on_which_other_maps_are_scored_beside() -> None:
    vectors = Boxes(OTHER_BOX, SYMMETRIC, BOX).vectors()
    together = scores_among(with_limits(1, 3), rig_of(panorama()), vectors, None)
    alone = [scores_among(with_limits(1, 3), rig_of(panorama()), [one], None)[0] for one in vectors]
    assert together == pytest.approx(alone, rel=0.01)
    assert max(range(3), key=together.__getitem__) == 2


@pytest.mark.slow
def test_of_few_maps_all_are_searched_at_once() -> None:
    boxes = Boxes(OTHER_BOX, BOX)
    found = among(boxes, panorama(), 2, 3)
    assert boxes.asked == [0, 1]
    assert best_of(found).map_position == 1


@pytest.mark.slow
@pytest.mark.parametrize(("count", "first"), [(16, list(range(16))), (17, [16, 0, 1, 2])])
def test_sixteen_maps_are_searched_at_once_and_of_more_the_four_likeliest(count: int, first: list[int]) -> None:
    boxes = Boxes(*(OTHER_BOX,) * (count - 1), BOX)
    found = localize_among(Localizer(device="cpu"), rig_of(panorama()), boxes)
    assert boxes.asked == first
    assert best_of(found).map_position == count - 1


@pytest.mark.slow
@pytest.mark.parametrize("most", [2, 3])
def test_where_no_likely_map_fits_others_are_searched_and_those_left_out_are_counted(most: int) -> None:
    boxes = Boxes(OTHER_BOX, SYMMETRIC, BOX)
    found = among(boxes, UNKNOWN.panorama(POSE), 1, most)
    assert found.status == "not_localized"
    # That of the likeliest so far is looked at once more, beside the others.
    assert len(set(boxes.asked[1:])) == len(boxes.asked) - 1 == most
    left_out = [warning for warning in found.warnings if "only the 2 of 3 maps were searched" in warning]
    assert len(left_out) == (most < 3)


@pytest.mark.slow
def test_what_may_be_in_another_map_is_the_less_sure() -> None:
    sure, likely, unlikely = (localized(panorama(), prior=prior) for prior in (1.0, 0.25, 0.0001))
    assert best_of(sure).confidence > best_of(likely).confidence > best_of(unlikely).confidence
    assert [found.status for found in (sure, likely, unlikely)] == ["localized", "localized", "not_localized"]
    twice = [localized(panorama(), BOX, BOX, prior=prior).status for prior in (0.25, 0.0001)]
    assert twice == ["ambiguous", "not_localized"]


@pytest.mark.slow
def test_one_photo_is_less_sure_of_one_of_many_maps() -> None:
    photo = Rig.of_photo(photo_of(SIDEWAYS))
    few, many = Boxes(BOX), Boxes(BOX, *(OTHER_BOX,) * 4, *(UNKNOWN,) * 5)
    alone, among_many = (localize_among(with_limits(1, 1), photo, boxes) for boxes in (few, many))
    assert set(many.asked) == {0}
    assert best_of(among_many).confidence < best_of(alone).confidence
    assert among_many.status == "localized"


@pytest.mark.slow
@pytest.mark.parametrize("most", [2, 4])
@pytest.mark.parametrize("image", ["panorama", "photo"])
def test_maps_that_look_the_same_are_searched_however_unlikely_they_seemed(
    monkeypatch: pytest.MonkeyPatch, image: str, most: int
) -> None:
    rig = rig_of(panorama()) if image == "panorama" else Rig.of_photo(photo_of(SIDEWAYS))
    boxes, likeness = Boxes(OTHER_BOX, BOX, UNKNOWN, BOX, OTHER_BOX), [[0.4, 0.9, 0.8, 0.5, 0.1]]
    monkeypatch.setattr(
        many_maps, "scores_among", lambda *given, **how: likeness.pop() if likeness else scores_among(*given, **how)
    )
    found = localize_among(with_limits(2, most), rig, boxes)
    assert found.status == "ambiguous"
    assert {best_of(found).map_position, *(each.map_position for each in found.alternatives)} == {1, 3}
    assert boxes.asked == [1, 2, 1, 3]


def test_a_view_stands_along_the_walls_of_its_map_however_these_stand() -> None:
    scan, turn = BOX.scan(), rotation_of(20.0)
    turned = build_map_index(replace(scan, positions=(scan.positions @ turn.T).astype(np.float32)), COARSE)
    views = [
        view_from(index, pose, 64).photos[0].color.astype(int)
        for index, pose in ((map_of(BOX, COARSE), POSE), (turned, Pose(POSE.rotation, turn @ POSE.position)))
    ]
    # Walls do not say which of four ways is forward.
    off = [np.abs(views[0] - np.roll(views[1], quarter * 32, 1)).mean() for quarter in range(4)]
    assert min(off) < 0.2 * sorted(off)[1]


def test_a_rig_that_stands_along_walls_is_held_against_maps_in_these_four_ways_alone() -> None:
    vectors = [retrieval_vectors(map_of(BOX))]

    def score(pose: Pose, *, along_walls: bool) -> float:
        return scores_among(with_limits(1, 3), rig_of(BOX.panorama(pose)), vectors, None, along_walls=along_walls)[0]

    along, across = (Pose(rotation_of(yaw), POSE.position) for yaw in (90.0, 45.0))
    assert score(along, along_walls=True) > 0.95 * score(along, along_walls=False)
    assert score(across, along_walls=True) < 0.7 * score(across, along_walls=False)


def test_maps_look_alike_that_score_nearly_what_one_scores_for_its_own_view() -> None:
    search = with_limits(3, 64).config.search
    assert search.look_alikes([0.8, 1.0, 0.95, 0.89, 1.1, 0.91], 1) == [4, 2]  # two at most, beside the one itself
    assert search.look_alikes([0.9, 1.0], 0) == [1]
    assert search.look_alikes([-math.inf, -math.inf], 0) == []  # labels, which have no colours


class Scripted(Localizer):
    """Answers with the confidences that are given, each in the first of the maps that it is asked for, or in the last."""

    def __init__(self, *answers: tuple[float, int]) -> None:
        super().__init__(with_limits(1, 3).config, "cpu")
        self._answers = list(answers)

    def localize(self, rig: Rig, maps: Sequence[MapIndex], **options: object) -> Localization:
        confidence, place = self._answers.pop(0)
        best = Candidate(POSE, place % len(maps), confidence, 1.0, 0.1, "none", 1)
        status: Status = "localized" if confidence > 0.75 else "not_localized"
        return Localization(status, SearchSummary("fast", len(maps), 1, 1, 1), {"search": 0.5}, best)


@pytest.mark.parametrize(
    ("answers", "confidence", "number"),
    [
        ([(0.9, 0)], 0.9, 2),  # sure: nothing else is searched
        ([(0.6, 0), (0.95, 0)], 0.95, 1),
        ([(0.6, 0), (0.3, 0)], 0.6, 2),  # the later answer does not know of the place of the first
        ([(0.6, 0), (0.3, -1)], 0.3, 2),  # it does, and something there spoke against it
    ],
)
def test_of_two_answers_the_better_one_counts(answers: list[tuple[float, int]], confidence: float, number: int) -> None:
    found = localize_among(Scripted(*answers), rig_of(panorama()), Boxes(OTHER_BOX, SYMMETRIC, BOX))
    assert (best_of(found).confidence, best_of(found).map_position) == (confidence, number)
    assert found.timings_s["search"] == 0.5 * len(answers)


@pytest.mark.slow
def test_a_place_registered_twice_is_ambiguous_among_many_maps() -> None:
    boxes = Boxes(BOX, OTHER_BOX, SYMMETRIC, BOX, OTHER_BOX)
    found = among(boxes, panorama(), 2, 4)
    assert found.status == "ambiguous"
    assert set(boxes.asked) == {0, 3}
    assert {best_of(found).map_position, *(each.map_position for each in found.alternatives)} == {0, 3}
