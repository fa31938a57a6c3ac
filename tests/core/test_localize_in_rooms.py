"""Localization end to end in generated rooms: furnished, changed, lit differently, labelled, seen by a scanner."""

from pathlib import Path

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.options import IndexOptions
from panoloc.core.panorama.session import Session, SessionImage
from panoloc.core.pictures import (
    draw_map_preview,
    draw_overlay,
    draw_score_map_2d,
    draw_score_map_3d,
    encode_png,
    view_scan,
)
from panoloc.core.results import Localization
from panoloc.lab.rooms import (
    Scene,
    SceneSpec,
    apply_look,
    build_scene,
    change_scene,
    changed_pixels,
    random_look,
    sample_pose,
    scan_scene,
    take_panorama,
    take_photo,
    take_view,
)
from tests.core.painted_box import rotation_of

pytestmark = pytest.mark.slow
WIDTH = 512


@pytest.fixture(scope="module")
def room() -> Scene:
    return build_scene(SceneSpec("room", seed=4, area_m2=14.0))


@pytest.fixture(scope="module")
def changed_room(room: Scene) -> Scene:
    return change_scene(room, 0.6, seed=1)


@pytest.fixture(scope="module")
def room_index(room: Scene) -> MapIndex:
    return build_map_index(scan_scene(room, num_points=60_000))


@pytest.fixture(scope="module")
def other_room_index() -> MapIndex:
    return build_map_index(scan_scene(build_scene(SceneSpec("room", seed=21, area_m2=16.0)), num_points=60_000))


def assert_found(found: Localization, pose: Pose) -> None:
    assert found.best is not None
    error = pose_error(found.best.pose, pose)
    assert error.within(0.05, 5.0), f"{error}, {found.status}, confidence {found.best.confidence:.2f}"


@pytest.mark.parametrize("seed", [5, 8])
def test_a_room_as_scanned_is_found_from_any_place_in_any_rotation(
    localizer: Localizer, room: Scene, room_index: MapIndex, seed: int
) -> None:
    pose = sample_pose(room, np.random.default_rng(seed), "any")
    found = localizer.localize(take_panorama(room, pose, WIDTH), [room_index])
    assert found.status == "localized"
    assert_found(found, pose)


@pytest.mark.parametrize("seed", [5, 8])
def test_a_room_with_60_percent_changed_is_found(
    localizer: Localizer, changed_room: Scene, room_index: MapIndex, seed: int
) -> None:
    pose = sample_pose(changed_room, np.random.default_rng(seed), "any")
    assert_found(localizer.localize(take_panorama(changed_room, pose, WIDTH), [room_index]), pose)


def test_a_photo_with_another_camera_and_light_is_found(
    localizer: Localizer, room: Scene, room_index: MapIndex
) -> None:
    for seed in range(2):
        pose = sample_pose(room, np.random.default_rng(seed), "tilted")
        look = random_look(np.random.default_rng(seed))
        found = localizer.localize(apply_look(take_panorama(room, pose, WIDTH), look, seed), [room_index])
        assert_found(found, pose)


def test_another_room_is_not_localized(
    localizer: Localizer, room: Scene, room_index: MapIndex, other_room_index: MapIndex
) -> None:
    for seed in range(2):
        pose = sample_pose(room, np.random.default_rng(seed), "any")
        panorama = take_panorama(room, pose, WIDTH)
        assert localizer.localize(panorama, [other_room_index]).status == "not_localized"
        both = localizer.localize(panorama, [other_room_index, room_index])
        assert both.best is not None
        assert both.best.map_position == 1


def test_a_semantic_room_is_found_by_its_labels(localizer: Localizer, room: Scene, changed_room: Scene) -> None:
    index = build_map_index(scan_scene(room, num_points=60_000, color_kind="labels"), IndexOptions(color_kind="labels"))
    for seed, scene in enumerate((room, changed_room)):
        pose = sample_pose(scene, np.random.default_rng(seed), "any")
        found = localizer.localize(take_panorama(scene, pose, WIDTH, "labels"), [index])
        assert_found(found, pose)


def test_a_room_scanned_from_one_place_alone_is_enough(localizer: Localizer, room: Scene) -> None:
    index = build_map_index(scan_scene(room, num_stations=1, num_points=60_000))
    pose = sample_pose(room, np.random.default_rng(5), "any")
    assert_found(localizer.localize(take_panorama(room, pose, WIDTH), [index]), pose)


def test_grid_starts_in_a_region_find_the_pose_as_well(localizer: Localizer, room: Scene) -> None:
    pose = sample_pose(room, np.random.default_rng(6), "any")
    low, high = (tuple((pose.position + side).tolist()) for side in (-0.9, 0.9))
    options = IndexOptions(starts_method="grid", spacing_m=0.6, region=(low, high))
    index = build_map_index(scan_scene(room, num_points=60_000), options)
    assert index.num_starts <= 27
    found = localizer.localize(take_panorama(room, pose, WIDTH), [index])
    assert_found(found, pose)


def test_the_2d_score_map_is_low_where_things_changed(
    localizer: Localizer, room: Scene, changed_room: Scene, room_index: MapIndex
) -> None:
    pose = sample_pose(changed_room, np.random.default_rng(7), "any")
    view = take_view(changed_room, pose, width=256)
    truth = changed_pixels(view, changed_room, room).reshape(128, 256)
    panorama = take_panorama(changed_room, pose, WIDTH)
    found = localizer.localize(panorama, [room_index])
    assert found.score_map_2d is not None
    scores = found.score_map_2d
    rows = np.arange(128) * scores.shape[0] // 128
    columns = np.arange(256) * scores.shape[1] // 256
    at_truth = scores[rows][:, columns]
    known = ~np.isnan(at_truth)
    changed, unchanged = at_truth[known & truth], at_truth[known & ~truth]
    # The chance that a changed pixel scores lower than an unchanged one.
    order = np.concatenate((changed, unchanged)).argsort().argsort()
    area = 1 - (order[: len(changed)].mean() - (len(changed) - 1) / 2) / len(unchanged)
    assert area > 0.8
    assert found.panorama_changed_fraction is not None
    assert abs(found.panorama_changed_fraction - truth.mean()) < 0.25


def test_the_pictures_of_an_answer_show_the_place(
    localizer: Localizer, room: Scene, room_index: MapIndex, tmp_path: Path
) -> None:
    pose = sample_pose(room, np.random.default_rng(5), "any")
    panorama = take_panorama(room, pose, WIDTH)
    found = localizer.localize(panorama, [room_index])
    view = view_scan(room_index, found)
    score_map, cloud_map = draw_score_map_2d(panorama, found), draw_score_map_3d(view)
    overlay, preview = draw_overlay(panorama, view), draw_map_preview(room_index)
    for picture in (score_map, cloud_map, overlay, preview):
        assert picture.dtype == np.uint8
        assert picture.shape[2] == 3
        assert float(picture.std()) > 10
        assert encode_png(picture)[:8] == b"\x89PNG\r\n\x1a\n"
    height = (overlay.shape[0] - 4) // 2
    upper, lower = overlay[:height].astype(float), overlay[-height:].astype(float)
    shown = np.abs(upper - lower).mean(axis=2)
    assert np.median(shown) < 25  # the scan below lies where the panorama above shows it
    mirrored = np.abs(upper - lower[:, ::-1]).mean(axis=2)
    assert shown.mean() < 0.7 * mirrored.mean()


def test_frames_of_a_phone_that_moves_are_found_within_two_centimetres(
    localizer: Localizer, room: Scene, room_index: MapIndex
) -> None:
    camera = Camera.from_hfov("pinhole", 640, 480, 69.0)
    middle = sample_pose(room, np.random.default_rng(5), "upright")
    images = []
    places = ((-35.0, (0.0, 0.2, 0.0)), (35.0, (0.0, -0.2, 0.1)), (100.0, (-0.2, 0.0, 0.0)), (190.0, (0.2, 0.0, -0.1)))
    for turn, place in places:
        tracked = Pose(rotation_of(turn, 5.0), np.array(place))
        view = take_photo(room, camera, middle.after(tracked))
        images.append(SessionImage(view.photo, tracked))
    found = localizer.localize(Session(tuple(images)), [room_index])
    assert found.map_from_session is not None
    error = pose_error(found.map_from_session, middle)
    assert error.within(0.02, 0.5), f"{error}, {found.status}"
    assert all(image.agreement is not None and image.agreement > 0.5 for image in found.images)
