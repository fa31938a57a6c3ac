"""Localization end to end in painted boxes, where scan and panorama are known in closed form."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama
from panoloc.core.errors import DeadlineExceededError, OptionsError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.core.options import Hints, IndexOptions
from tests.core.built_maps import (
    AS_LABELS,
    BOX,
    COARSE,
    LABELLED,
    OTHER_BOX,
    POSE,
    SYMMETRIC,
    TWIN,
    answer,
    localized,
    localizer,
    map_of,
    panorama,
    rig_of,
)
from tests.core.found_pose import assert_found, best_of, known
from tests.core.painted_box import PaintedBox, rotation_of


def test_a_panorama_is_found_within_a_centimetre_and_a_third_of_a_degree() -> None:
    found = answer()
    assert_found(found, POSE, 0.01, 0.3)
    assert found.status == "localized"
    assert best_of(found).confidence > 0.9
    assert found.warnings == ()
    error = pose_error(best_of(found).pose, POSE)
    assert error.position_m / 10 < known(found.accuracy_position_m) < 0.1
    assert error.orientation_deg / 10 < known(found.accuracy_orientation_deg) < 2.0


def test_an_unchanged_place_has_hardly_changed() -> None:
    found = answer()
    assert max(known(found.panorama_changed_fraction), known(found.map_changed_fraction)) < 0.1
    assert found.score_map_2d is not None
    assert found.score_map_2d.shape[1] == 2 * found.score_map_2d.shape[0]
    assert float(np.nanmedian(found.score_map_2d)) > 0.8


def test_an_answer_carries_losses_iterations_timings_and_the_runner_up() -> None:
    found = localized(panorama(), map_of(BOX))
    best = best_of(found)
    assert {"prepare", "search", "refine", "judge"} <= set(found.timings_s)
    assert all(seconds >= 0 for seconds in found.timings_s.values())
    # The first pass spares most poses.
    assert 0 < found.search.num_poses < found.search.num_starts * found.search.num_rotations
    assert (found.search.method, found.search.num_maps) == ("fast", 1)
    assert found.evidence is not None
    runner_up = found.evidence.runner_up_score
    assert (
        runner_up is None or runner_up < best.score
    )  # in a room that looks like nothing else all may come to one place
    assert found.evidence.formal_radii is not None
    assert 0 <= best.sampling_loss <= 1
    assert best.num_iterations > 0


@pytest.mark.slow
def test_the_same_query_gives_the_same_answer_to_the_bit() -> None:
    one, again = answer(), localized(panorama())
    np.testing.assert_array_equal(best_of(again).pose.matrix, best_of(one).pose.matrix)
    assert (best_of(again).score, best_of(again).confidence) == (best_of(one).score, best_of(one).confidence)
    np.testing.assert_array_equal(again.score_map_2d, known(one.score_map_2d))


@pytest.mark.slow
def test_registration_gives_the_same_bytes_twice() -> None:
    cloud, options = BOX.scan(3000), IndexOptions(spacing_m=1.5)
    assert encode_map_index(build_map_index(cloud, options)) == encode_map_index(build_map_index(cloud, options))


@pytest.mark.slow
def test_a_scan_of_few_points_gives_a_pose_that_is_within_what_is_said_of_it() -> None:
    box, pose = PaintedBox(seed=3, size_m=(3.2, 3.0, 2.4)), Pose(rotation_of(20.0, 3.0), np.array([1.4, 1.8, 1.3]))
    found = localized(box.panorama(pose), build_map_index(box.scan(6_000), COARSE))
    assert found.status == "localized"
    assert_found(found, pose, 0.05, 1.0)
    error = pose_error(best_of(found).pose, pose)
    assert error.position_m / 10 < known(found.accuracy_position_m) < 0.3
    assert error.orientation_deg / 10 < known(found.accuracy_orientation_deg) < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("angles", [(0.0, 90.0, 0.0), (20.0, -80.0, 45.0), (-100.0, 10.0, 179.0)])
def test_any_rotation_is_found_also_towards_the_zenith_and_upside_down(angles: tuple[float, float, float]) -> None:
    pose = Pose(rotation_of(*angles), np.array([3.4, 1.3, 1.1]))
    found = localized(BOX.panorama(pose))
    assert found.status == "localized"
    assert_found(found, pose)


@pytest.mark.parametrize(
    ("options", "named"), [({"top_k": 0}, "top_k"), ({"top_k": 33}, "top_k"), ({"method": "slow"}, "method")]
)
def test_options_out_of_range_are_refused(options: dict[str, Any], named: str) -> None:
    with pytest.raises(OptionsError, match=named):
        localized(panorama(), **options)


def test_no_map_at_all_is_refused() -> None:
    with pytest.raises(OptionsError, match="maps"):
        localizer().localize(rig_of(panorama()), [])


@pytest.mark.parametrize("timeout_s", [0.0, 0.05])
def test_a_deadline_that_has_passed_raises(timeout_s: float) -> None:
    with pytest.raises(DeadlineExceededError):
        localized(panorama(), timeout_s=timeout_s)


# Masks.


@pytest.mark.slow
def test_a_panorama_masked_by_half_is_still_found_and_what_is_under_the_mask_has_no_influence() -> None:
    valid, color = panorama().valid.copy(), panorama().color.copy()
    valid[:, 256:] = False
    found = localized(Panorama(color, valid))
    assert found.status == "localized"
    assert_found(found, POSE)
    color[~valid] = 255
    again = localized(Panorama(color, valid))
    np.testing.assert_array_equal(best_of(again).pose.matrix, best_of(found).pose.matrix)
    assert best_of(again).confidence == best_of(found).confidence


@pytest.mark.slow
def test_black_pixels_count_unless_they_are_masked() -> None:
    # The same black area: as a colour it is a change, under a mask it is nothing at all.
    area, black = np.zeros((256, 512), bool), panorama().color.copy()
    area[90:170, 60:260] = True
    black[area] = 0
    seen, ignored = (
        localized(Panorama(black, valid)).panorama_changed_fraction for valid in (np.ones_like(area), ~area)
    )
    assert seen is not None
    assert ignored is not None
    assert seen > ignored + 0.05


# Light.


def relit(gain: tuple[float, float, float], gamma: float) -> Panorama:
    color = (panorama().color / 255.0) ** gamma * gain
    return dataclasses.replace(panorama(), color=(np.clip(color, 0, 1) * 255).round().astype(np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "gamma"), [((0.67, 0.67, 0.67), 1.0), ((1.0, 1.0, 1.0), 3.0), ((1.0, 0.5, 0.5), 1.0)])
def test_the_light_changes_of_the_paper_do_not_matter(gain: tuple[float, float, float], gamma: float) -> None:
    found = localized(relit(gain, gamma))
    assert found.status == "localized"
    assert_found(found, POSE)


def lit_by_a_lamp(panorama: Panorama) -> Panorama:
    """Return the panorama as a lamp on one side lights it: eight times as bright there as on the other side."""
    height, width = panorama.color.shape[:2]
    azimuth = np.arange(width) * 2 * np.pi / width - 1
    elevation = np.linspace(-1, 1, height)[:, None] + 0.2
    light = 0.12 + 0.9 * np.exp(3 * (np.cos(azimuth) - 1)) * np.exp(-2 * elevation**2)
    lit = np.clip(panorama.color * (1.3 * np.clip(light, 0, 1))[..., None], 0, 255)
    return Panorama(lit.astype(np.uint8), panorama.valid)


@pytest.mark.slow
def test_a_lamp_hardly_moves_the_pose() -> None:
    assert_found(localized(lit_by_a_lamp(panorama())), POSE, 0.01, 0.3)


# Several maps, wrong maps, ambiguity.


@pytest.mark.slow
def test_a_map_of_another_place_is_not_localized_in() -> None:
    found = localized(panorama(), OTHER_BOX)
    assert found.status == "not_localized"
    assert found.best is None or found.best.confidence < 0.5


@pytest.mark.slow
def test_of_several_maps_the_right_one_is_named() -> None:
    found = localized(panorama(), OTHER_BOX, BOX)
    assert found.status == "localized"
    assert best_of(found).map_position == 1
    assert found.search.num_maps == 2
    assert_found(found, POSE)


@pytest.mark.slow
def test_one_place_registered_twice_is_ambiguous() -> None:
    found = localized(panorama(), BOX, OTHER_BOX, BOX)
    assert found.status == "ambiguous"
    assert {best_of(found).map_position, *(each.map_position for each in found.alternatives)} == {0, 2}


@pytest.mark.slow
def test_a_room_that_looks_the_same_from_both_sides_is_ambiguous_and_both_sides_are_named() -> None:
    found = localized(SYMMETRIC.panorama(POSE), SYMMETRIC, top_k=2)
    assert found.status == "ambiguous"
    (other,) = found.alternatives
    evidence = known(found.evidence)
    assert evidence.runner_up_score == other.score
    assert evidence.alias_margins == pytest.approx((1 - other.score / best_of(found).score,))
    for side in (POSE, TWIN):
        assert any(pose_error(each.pose, side).within(0.05, 5.0) for each in (best_of(found), other))


@pytest.mark.slow
def test_a_hint_decides_between_the_sides_of_a_symmetric_room() -> None:
    hints = Hints(heading_deg=math.degrees(POSE.yaw_pitch_roll[0]) + 20, heading_tolerance_deg=60)
    found = localized(SYMMETRIC.panorama(POSE), SYMMETRIC, hints=hints)
    assert found.status == "localized"
    assert_found(found, POSE)


@pytest.mark.slow
def test_a_scan_with_survey_coordinates_gives_poses_in_survey_coordinates() -> None:
    offset = np.array([4_500_000.25, 5_400_000.5, 312.125])
    index = build_map_index(BOX.scan(origin_offset=offset), IndexOptions(spacing_m=1.5))
    near = tuple((offset + np.array([1.9, 2.2, 1.4])).tolist())
    found = localized(panorama(), index, hints=Hints(position_m=near, radius_m=0.7))
    assert_found(found, Pose(POSE.rotation, POSE.position + offset))
    assert (index.start_positions.min(axis=0) > offset).all()
    assert (index.bounds[0] > offset - 0.1).all()


@pytest.mark.slow
def test_a_map_that_went_through_its_bytes_gives_the_same_pose_within_millimetres() -> None:
    index = map_of(BOX)
    before, after = localized(panorama(), index), localized(panorama(), decode_map_index(encode_map_index(index)))
    assert_found(after, POSE, 0.01, 0.3)
    assert_found(after, best_of(before).pose, 0.003, 0.1)


@pytest.mark.slow
def test_semantic_labels_are_localized_by_their_boundaries() -> None:
    found = localized(LABELLED.panorama(POSE), map_of(LABELLED, AS_LABELS))
    assert found.status == "localized"
    assert best_of(found).color_model == "labels"
    assert_found(found, POSE)


@pytest.mark.slow
def test_one_place_registered_twice_by_its_labels_is_ambiguous() -> None:
    index = map_of(LABELLED, AS_LABELS)
    found = localized(LABELLED.panorama(POSE), index, decode_map_index(encode_map_index(index)))
    assert found.status == "ambiguous"
    assert {best_of(found).map_position, *(each.map_position for each in found.alternatives)} == {0, 1}
