"""Localization end to end in generated rooms: furnished, changed, lit differently, labelled, seen by a scanner."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.decide import pictures
from panoloc.core.geometry.pose import Pose
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import IndexOptions
from panoloc.core.results import Localization
from panoloc.lab import rooms
from tests.core.built_maps import localized
from tests.core.found_pose import assert_found, known
from tests.core.painted_box import rotation_of

pytestmark = pytest.mark.slow
WIDTH = 512
ROOM = rooms.build_scene(rooms.SceneSpec("room", seed=4, area_m2=14.0))


@cache
def changed_room() -> rooms.Scene:
    return rooms.change_scene(ROOM, 0.6, seed=1)


@cache
def room_index() -> MapIndex:
    return build_map_index(rooms.scan_scene(ROOM, num_points=60_000))


def pose_in(scene: rooms.Scene, seed: int, held: str = "any") -> Pose:
    return rooms.sample_pose(scene, np.random.default_rng(seed), held)  # type: ignore[arg-type]


@cache
def answer_from(seed: int) -> tuple[Panorama, Localization]:
    """Return what is seen from a place in the room as scanned, and the answer to it."""
    seen = rooms.take_panorama(ROOM, pose_in(ROOM, seed), WIDTH)
    return seen, localized(seen, room_index())


@pytest.mark.parametrize("seed", [5, 8])
def test_a_room_as_scanned_is_found_from_any_place_in_any_rotation(seed: int) -> None:
    _, found = answer_from(seed)
    assert found.status == "localized"
    assert_found(found, pose_in(ROOM, seed))


@pytest.mark.parametrize(("above", "below"), [(0, 36), (20, 20), (12, 48)])
def test_a_panorama_is_found_whatever_was_cut_off_of_it(above: int, below: int) -> None:
    pose = pose_in(ROOM, 5, "upright")
    whole = rooms.take_panorama(ROOM, pose, WIDTH)
    rows = slice(above, len(whole.valid) - below)
    camera = Camera.from_hfov("equirectangular", WIDTH, rows.stop - rows.start, 360.0)
    found = localized(Photo(whole.color[rows], whole.valid[rows], camera, focal_uncertainty=0.006), room_index())
    assert found.status == "localized"
    assert_found(found, pose, 0.03)


@pytest.mark.parametrize("said_deg", [200.0, 230.0])
def test_a_sweep_is_found_and_as_wide_as_it_is_whether_or_not_its_width_is_known(said_deg: float) -> None:
    pose, taken = pose_in(ROOM, 5, "upright"), Camera.from_hfov("cylindrical", 400, 130, 200.0)
    seen = rooms.take_photo(ROOM, taken, pose).photo
    said = Camera.from_hfov("cylindrical", 400, 130, said_deg)
    found = localized(replace(seen, camera=said, focal_uncertainty=0.006), room_index())
    assert found.status == "localized"
    assert_found(found, pose, 0.02 if said_deg == 200.0 else 0.1)
    assert known(found.found_cameras)[0].hfov_deg == pytest.approx(200.0, abs=3.0)
    assert bool(found.warnings) == (said_deg != 200.0)


@pytest.mark.parametrize("seed", [5, 8])
def test_a_room_with_60_percent_changed_is_found(seed: int) -> None:
    pose = pose_in(changed_room(), seed)
    assert_found(localized(rooms.take_panorama(changed_room(), pose, WIDTH), room_index()), pose)


def test_a_photo_with_another_camera_and_light_is_found() -> None:
    pose, look = pose_in(ROOM, 0, "tilted"), rooms.random_look(np.random.default_rng(0))
    assert_found(localized(rooms.apply_look(rooms.take_panorama(ROOM, pose, WIDTH), look, 0), room_index()), pose)


def test_a_room_scanned_from_one_place_alone_is_enough_also_with_starts_in_a_grid() -> None:
    pose = pose_in(ROOM, 5)
    low, high = (tuple((pose.position + side).tolist()) for side in (-0.9, 0.9))
    options = IndexOptions(starts_method="grid", spacing_m=0.6, region=(low, high))
    index = build_map_index(rooms.scan_scene(ROOM, num_stations=1, num_points=60_000), options)
    assert index.num_starts <= 27
    assert_found(localized(answer_from(5)[0], index), pose)


def test_the_2d_score_map_is_low_where_things_changed() -> None:
    pose = pose_in(changed_room(), 7)
    truth = rooms.changed_pixels(rooms.take_view(changed_room(), pose, width=256), changed_room(), ROOM).reshape(
        128, 256
    )
    found = localized(rooms.take_panorama(changed_room(), pose, WIDTH), room_index())
    scores = known(found.score_map_2d)
    rows = np.arange(128) * scores.shape[0] // 128
    columns = np.arange(256) * scores.shape[1] // 256
    at_truth = scores[rows][:, columns]
    is_known = ~np.isnan(at_truth)
    changed, unchanged = at_truth[is_known & truth], at_truth[is_known & ~truth]
    # The chance that a changed pixel scores lower than an unchanged one.
    order = np.concatenate((changed, unchanged)).argsort().argsort()
    area = 1 - (order[: len(changed)].mean() - (len(changed) - 1) / 2) / len(unchanged)
    assert area > 0.8
    assert abs(known(found.panorama_changed_fraction) - truth.mean()) < 0.25


def test_the_pictures_of_an_answer_show_the_place() -> None:
    panorama, found = answer_from(5)
    view = pictures.view_scan(room_index(), found)
    overlay = pictures.draw_overlay(panorama, view)
    others = (
        pictures.draw_score_map_2d(panorama, found),
        pictures.draw_score_map_3d(view),
        pictures.draw_map_preview(room_index()),
    )
    for picture in (overlay, *others):
        assert picture.dtype == np.uint8
        assert picture.shape[2] == 3
        assert float(picture.std()) > 10
        assert pictures.encode_png(picture)[:8] == b"\x89PNG\r\n\x1a\n"
    height = (overlay.shape[0] - 4) // 2
    upper, lower = overlay[:height].astype(float), overlay[-height:].astype(float)
    shown = np.abs(upper - lower).mean(axis=2)
    assert np.median(shown) < 25  # the scan below lies where the panorama above shows it
    mirrored = np.abs(upper - lower[:, ::-1]).mean(axis=2)
    assert shown.mean() < 0.7 * mirrored.mean()


def test_frames_of_a_phone_that_moves_are_found_within_two_centimetres() -> None:
    camera, middle = Camera.from_hfov("pinhole", 640, 480, 69.0), pose_in(ROOM, 5, "upright")
    images = []
    places = ((-35.0, (0.0, 0.2, 0.0)), (35.0, (0.0, -0.2, 0.1)), (100.0, (-0.2, 0.0, 0.0)), (190.0, (0.2, 0.0, -0.1)))
    for turn, place in places:
        tracked = Pose(rotation_of(turn, 5.0), np.array(place))
        images.append(RigImage(rooms.take_photo(ROOM, camera, middle.after(tracked)).photo, tracked))
    found = localized(Rig(tuple(images)), room_index())
    assert found.map_from_session is not None
    assert_found(found, middle.after(images[0].session_from_camera), 0.02, 0.5)
    assert all(image.agreement is not None and image.agreement > 0.5 for image in found.images)


@pytest.mark.parametrize(
    ("seed", "stated_deg", "uncertainty"), [(5, 50.0, 0.01), (8, 50.0, 0.01), (5, 58.0, 0.0), (8, 80.0, 0.0)]
)
def test_a_photo_contradicts_its_stated_focal_length_also_a_measured_one(
    seed: int, stated_deg: float, uncertainty: float
) -> None:
    pose = pose_in(ROOM, seed, "upright")
    taken, stated = (Camera.from_hfov("pinhole", 640, 480, hfov_deg) for hfov_deg in (66.0, stated_deg))
    photo = rooms.take_photo(ROOM, taken, pose).photo
    found = localized(replace(photo, camera=stated, focal_uncertainty=uncertainty), room_index())
    assert found.status == "localized"
    assert_found(found, pose, 0.1)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([66.0], abs=2.0)
    assert [warning.reason for warning in found.warnings] == ["hfov_contradicted"]


def test_a_photo_that_shows_more_than_is_stated_is_not_surely_where_it_would_show_less() -> None:
    pose = pose_in(ROOM, 17, "upright")
    taken, stated = (Camera.from_hfov("pinhole", 640, 480, hfov_deg) for hfov_deg in (66.0, 50.0))
    photo = rooms.take_photo(ROOM, taken, pose).photo
    assert localized(replace(photo, camera=stated, focal_uncertainty=0.01), room_index()).status == "not_localized"


def test_a_photo_of_which_little_is_known_is_not_taken_for_a_narrow_one() -> None:
    pose, camera = pose_in(ROOM, 8, "upright"), Camera.from_hfov("pinhole", 640, 480, 69.0)
    photo = rooms.take_photo(ROOM, camera, pose).photo
    guess = Camera.from_hfov("pinhole", 640, 480, 60.0)
    found = localized(replace(photo, camera=guess, hfov_range_deg=(20.0, 120.0)), room_index())
    assert found.status == "localized"
    # A field of view that is one degree off moves the camera by centimetres.
    assert_found(found, pose, 0.06)
    assert found.found_cameras[0].hfov_deg == pytest.approx(69.0, abs=4.0)
