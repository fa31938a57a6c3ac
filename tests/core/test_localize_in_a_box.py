"""Localization end to end in painted boxes, where scan and panorama are known in closed form."""

import dataclasses
import math

import numpy as np
import pytest

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_codec import decode_map_index, encode_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.options import Hints, IndexOptions
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.results import Localization
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.built_maps import AS_LABELS, LABELLED, map_of
from tests.core.found_pose import assert_found
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.search.symmetric_box import BOX as SYMMETRIC
from tests.core.search.symmetric_box import POSE, TWIN


def test_a_panorama_is_found_within_a_centimetre_and_a_third_of_a_degree(answer: Localization, box_pose: Pose) -> None:
    assert_found(answer, box_pose, 0.01, 0.3)
    assert answer.status == "localized"
    assert answer.best is not None
    assert answer.best.confidence > 0.9
    assert answer.warnings == ()


def test_the_stated_accuracy_covers_the_error_within_a_factor_of_ten(answer: Localization, box_pose: Pose) -> None:
    assert answer.best is not None
    assert answer.accuracy_position_m is not None
    assert answer.accuracy_orientation_deg is not None
    error = pose_error(answer.best.pose, box_pose)
    assert error.position_m / 10 < answer.accuracy_position_m < 0.1
    assert error.orientation_deg / 10 < answer.accuracy_orientation_deg < 2.0


def test_an_unchanged_place_has_hardly_changed(answer: Localization) -> None:
    assert answer.panorama_changed_fraction is not None
    assert answer.map_changed_fraction is not None
    assert answer.panorama_changed_fraction < 0.1
    assert answer.map_changed_fraction < 0.1
    assert answer.score_map_2d is not None
    assert answer.score_map_2d.shape[1] == 2 * answer.score_map_2d.shape[0]
    assert float(np.nanmedian(answer.score_map_2d)) > 0.8


def test_an_answer_carries_losses_iterations_timings_and_the_runner_up(answer: Localization) -> None:
    assert {"prepare", "search", "refine", "judge"} <= set(answer.timings_s)
    assert all(seconds >= 0 for seconds in answer.timings_s.values())
    # The first pass spares most poses.
    assert 0 < answer.search.num_poses < answer.search.num_starts * answer.search.num_rotations
    assert (answer.search.method, answer.search.num_maps) == ("fast", 1)
    assert answer.best is not None
    assert answer.evidence is not None
    assert answer.evidence.runner_up_score is not None
    assert answer.best.score > answer.evidence.runner_up_score
    assert answer.evidence.formal_radii is not None
    assert 0 <= answer.best.sampling_loss <= 1
    assert answer.best.num_iterations > 0


@pytest.mark.slow
def test_the_same_query_gives_the_same_answer_to_the_bit(
    answer: Localization, localizer: Localizer, box_index: MapIndex, box_panorama: Panorama
) -> None:
    again = localizer.localize(box_panorama, [box_index])
    assert answer.best is not None
    assert again.best is not None
    np.testing.assert_array_equal(again.best.pose.rotation, answer.best.pose.rotation)
    np.testing.assert_array_equal(again.best.pose.position, answer.best.pose.position)
    assert again.best.score == answer.best.score
    assert again.best.confidence == answer.best.confidence
    assert again.score_map_2d is not None
    assert answer.score_map_2d is not None
    np.testing.assert_array_equal(again.score_map_2d, answer.score_map_2d)


@pytest.mark.slow
def test_registration_gives_the_same_bytes_twice(box: PaintedBox) -> None:
    cloud = box.scan(3000)
    options = IndexOptions(spacing_m=1.5)
    assert encode_map_index(build_map_index(cloud, options)) == encode_map_index(build_map_index(cloud, options))


@pytest.mark.slow
@pytest.mark.parametrize("angles", [(0.0, 90.0, 0.0), (20.0, -80.0, 45.0), (-100.0, 10.0, 179.0)])
def test_any_rotation_is_found_also_towards_the_zenith_and_upside_down(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, angles: tuple[float, float, float]
) -> None:
    pose = Pose(rotation_of(*angles), np.array([3.4, 1.3, 1.1]))
    found = localizer.localize(box.panorama(pose), [box_index])
    assert found.status == "localized"
    assert_found(found, pose)


# Light.


def relit(panorama: Panorama, gain: tuple[float, float, float] = (1, 1, 1), gamma: float = 1.0) -> Panorama:
    color = (panorama.color / 255.0) ** gamma * gain
    return dataclasses.replace(panorama, color=(np.clip(color, 0, 1) * 255).round().astype(np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "gamma"), [((0.67, 0.67, 0.67), 1.0), ((1.0, 1.0, 1.0), 3.0), ((1.0, 0.5, 0.5), 1.0)])
def test_the_light_changes_of_the_paper_do_not_matter(
    localizer: Localizer,
    box_index: MapIndex,
    box_panorama: Panorama,
    box_pose: Pose,
    gain: tuple[float, float, float],
    gamma: float,
) -> None:
    found = localizer.localize(relit(box_panorama, gain, gamma), [box_index])
    assert found.status == "localized"
    assert_found(found, box_pose)


# Several maps, wrong maps, ambiguity.


@pytest.mark.slow
def test_a_map_of_another_place_is_not_localized_in(
    localizer: Localizer, other_box_index: MapIndex, box_panorama: Panorama
) -> None:
    found = localizer.localize(box_panorama, [other_box_index])
    assert found.status == "not_localized"
    assert found.best is None or found.best.confidence < 0.5


@pytest.mark.slow
def test_of_several_maps_the_right_one_is_named(
    localizer: Localizer, box_index: MapIndex, other_box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    found = localizer.localize(box_panorama, [other_box_index, box_index])
    assert found.status == "localized"
    assert found.best is not None
    assert found.best.map_position == 1
    assert found.search.num_maps == 2
    assert_found(found, box_pose)


@pytest.mark.slow
def test_a_room_that_looks_the_same_from_both_sides_is_ambiguous_and_both_sides_are_named(localizer: Localizer) -> None:
    found = localizer.localize(SYMMETRIC.panorama(POSE), [map_of(SYMMETRIC)], top_k=2)
    assert found.status == "ambiguous"
    assert found.best is not None
    (other,) = found.alternatives
    for side in (POSE, TWIN):
        assert any(pose_error(each.pose, side).within(0.05, 5.0) for each in (found.best, other))


@pytest.mark.slow
def test_a_hint_decides_between_the_sides_of_a_symmetric_room(localizer: Localizer) -> None:
    hints = Hints(heading_deg=math.degrees(POSE.yaw_pitch_roll[0]) + 20, heading_tolerance_deg=60)
    found = localizer.localize(SYMMETRIC.panorama(POSE), [map_of(SYMMETRIC)], hints=hints)
    assert found.status == "localized"
    assert_found(found, POSE)


@pytest.mark.slow
def test_a_scan_with_survey_coordinates_gives_poses_in_survey_coordinates(
    localizer: Localizer, box: PaintedBox, box_panorama: Panorama, box_pose: Pose
) -> None:
    offset = np.array([4_500_000.25, 5_400_000.5, 312.125])
    index = build_map_index(box.scan(origin_offset=offset), IndexOptions(spacing_m=0.8))
    near = tuple((offset + np.array([1.9, 2.2, 1.4])).tolist())
    found = localizer.localize(box_panorama, [index], hints=Hints(position_m=near, radius_m=0.7))
    assert_found(found, Pose(box_pose.rotation, box_pose.position + offset))
    assert (index.start_positions.min(axis=0) > offset).all()
    assert (index.bounds[0] > offset - 0.1).all()


@pytest.mark.slow
def test_a_map_that_went_through_its_bytes_gives_the_same_pose_within_millimetres(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama, box_pose: Pose, answer: Localization
) -> None:
    found = localizer.localize(box_panorama, [decode_map_index(encode_map_index(box_index))])
    assert_found(found, box_pose, 0.01, 0.3)
    assert answer.best is not None
    assert found.best is not None
    assert pose_error(found.best.pose, answer.best.pose).within(0.003, 0.1)


@pytest.mark.slow
def test_a_scan_of_part_of_the_room_is_enough(
    localizer: Localizer, box: PaintedBox, box_panorama: Panorama, box_pose: Pose
) -> None:
    cloud = box.scan()
    kept = cloud.positions[:, 0] < 3.4  # the far wall and a third of everything else was never scanned
    part = PointCloud(cloud.positions[kept], cloud.colors[kept])
    found = localizer.localize(box_panorama, [build_map_index(part, IndexOptions(spacing_m=0.7))])
    assert found.status == "localized"
    assert_found(found, box_pose)


@pytest.mark.slow
def test_semantic_labels_are_localized_by_their_boundaries(localizer: Localizer, box_pose: Pose) -> None:
    found = localizer.localize(LABELLED.panorama(box_pose), [map_of(LABELLED, AS_LABELS)])
    assert found.status == "localized"
    assert found.best is not None
    assert found.best.color_model == "labels"
    assert_found(found, box_pose)


@pytest.mark.slow
def test_one_place_registered_twice_is_ambiguous(
    localizer: Localizer, box_index: MapIndex, other_box_index: MapIndex, box_panorama: Panorama
) -> None:
    found = localizer.localize(box_panorama, [box_index, other_box_index, box_index])
    assert found.status == "ambiguous"
    assert found.best is not None
    assert {found.best.map_position, *(each.map_position for each in found.alternatives)} == {0, 2}


def lit_by_a_lamp(panorama: Panorama) -> Panorama:
    """Return the panorama as a lamp on one side lights it: eight times as bright there as on the other side."""
    height, width = panorama.color.shape[:2]
    azimuth = np.arange(width) * 2 * np.pi / width - 1
    elevation = np.linspace(-1, 1, height)[:, None] + 0.2
    light = 0.12 + 0.9 * np.exp(3 * (np.cos(azimuth) - 1)) * np.exp(-2 * elevation**2)
    lit = np.clip(panorama.color * (1.3 * np.clip(light, 0, 1))[..., None], 0, 255)
    return Panorama(lit.astype(np.uint8), panorama.valid)


@pytest.mark.slow
def test_a_lamp_hardly_moves_the_pose(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    pose, panorama = box_pose, lit_by_a_lamp(box_panorama)
    colors_alone = dataclasses.replace(LocalizerConfig().refinement, contrast_share=0.0, fine_contrast_share=0.0)
    without = Localizer(dataclasses.replace(LocalizerConfig(), refinement=colors_alone), device="cpu")
    found, off = localizer.localize(panorama, [box_index]), without.localize(panorama, [box_index])
    assert_found(found, pose, 0.015, 0.3)
    assert found.best is not None
    assert off.best is not None
    assert pose_error(found.best.pose, pose).position_m < 0.75 * pose_error(off.best.pose, pose).position_m
