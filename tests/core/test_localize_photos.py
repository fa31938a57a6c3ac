"""Photos of ordinary cameras in a painted box: one alone, and several whose poses among each other are known."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Rig, RigImage
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.agreement import PhotoAgreement
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.localizer import Localizer
from panoloc.core.options import DEFAULT_TOLERANCE_DEG, MAX_SESSION_TILT_DEG, Hints
from panoloc.core.query.engine import Engine
from panoloc.core.results import Localization
from tests.core.built_maps import (
    BOX,
    OTHER_BOX,
    POSE,
    SYMMETRIC,
    TWIN,
    localized,
    map_of,
    seen_from_the_other_side,
)
from tests.core.found_pose import assert_found, best_of, known
from tests.core.image.painted_photos import FOUR, MAP_FROM_SESSION, SIDEWAYS, TWO, photo_of, session_of
from tests.core.painted_box import rotation_of

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
WIDE = Camera.from_hfov("pinhole", 640, 480, 100.0)
SESSION = session_of(FOUR)
AT = np.array([1.9, 2.2, 1.4])


@cache
def of_four() -> Localization:
    """Return the answer to four photos."""
    return localized(SESSION)


def session_pose(found: Localization) -> Pose:
    return known(found.map_from_session)


def assert_same(found: Pose, expected: Pose) -> None:
    np.testing.assert_allclose(found.matrix, expected.matrix, atol=1e-6)


def in_axes(session: Rig, axes: Pose) -> Rig:
    """Return the session with poses in other axes of its own."""
    images = (replace(image, session_from_camera=axes.after(image.session_from_camera)) for image in session.images)
    return replace(session, images=tuple(images))


def test_radii_of_several_photos_contain_the_noise_of_their_tracking() -> None:
    def radii(position_m: float, orientation_deg: float) -> list[float]:
        options = replace(SESSION.options, position_noise_m=position_m, orientation_noise_deg=orientation_deg)
        found = localized(replace(SESSION, options=options))
        return [each for each in (found.accuracy_position_m, found.accuracy_orientation_deg) if each is not None]

    silent, noisy = radii(1e-6, 1e-6), radii(0.02, 1.0)
    assert noisy == pytest.approx([math.hypot(*each) for each in zip(silent, (0.03, 1.0), strict=True)], rel=1e-3)


def test_photos_are_asked_for_their_edges() -> None:
    assert (of_four().status, of_four().warnings) == ("localized", ())
    config = replace(CONFIG, judge=replace(CONFIG.judge, least_edges_deg=1e6))
    refused = Localizer(config, device="cpu").localize(SESSION, [map_of(BOX)])
    assert refused.status == "not_localized"
    assert "next to no edges" in refused.warnings[0]


# One photo.


def test_a_photo_is_found_where_it_was_taken_and_is_its_own_session() -> None:
    found = localized(photo_of(WIDE), OTHER_BOX, BOX)
    assert_found(found, POSE, 0.1, 5.0)
    assert best_of(found).map_position == 1
    (image,) = found.images
    assert_same(image.pose, best_of(found).pose)
    assert_same(session_pose(found), best_of(found).pose)
    assert known(image.agreement) > 0.9


def test_a_photo_is_found_as_a_masked_sphere_and_a_narrower_one_with_a_hint() -> None:
    photo = photo_of(WIDE)
    assert_found(localized(rig_on_sphere(Rig.of_photo(photo))), POSE, 0.1, 5.0)
    narrow = photo_of(Camera.from_hfov("pinhole", 640, 480, 75.0))
    assert_found(localized(narrow, hints=Hints(upright=True)), POSE, 0.1, 5.0)


def test_a_photo_of_another_place_is_never_localized() -> None:
    assert localized(photo_of(WIDE), OTHER_BOX).status == "not_localized"


@pytest.mark.parametrize("form", ["photo", "frames"])
def test_a_room_that_looks_the_same_from_both_sides_is_ambiguous_and_both_are_named(form: str) -> None:
    if form == "photo":
        asked, here, there = Rig.of_photo(photo_of(WIDE, POSE, SYMMETRIC)), POSE, TWIN
    else:
        asked = session_of(FOUR, SYMMETRIC)
        here = MAP_FROM_SESSION.after(FOUR[0])
        there = seen_from_the_other_side(here)
    found = localized(asked, SYMMETRIC)
    assert found.status == "ambiguous"
    named = (best_of(found).pose, found.alternatives[0].pose)
    for side in (here, there):
        assert any(pose_error(pose, side).within(0.1, 5.0) for pose in named)


def test_cameras_held_level_are_searched_first_and_others_are_found_as_well() -> None:
    level, upside_down = (Pose(rotation_of(*angles), AT) for angles in ((70.0, 6.0, -4.0), (70.0, 6.0, 176.0)))
    first, second = (localized(photo_of(WIDE, pose)) for pose in (level, upside_down))
    assert_found(first, level, 0.05, 2.0)
    assert_found(second, upside_down, 0.05, 2.0)
    assert first.search.num_poses <= second.search.num_poses / 2


def test_what_has_changed_is_told_in_the_axes_of_the_photo() -> None:
    pose = Pose(rotation_of(70.0, 30.0, 10.0), AT)
    photo, index = photo_of(WIDE, pose), map_of(BOX)
    found = localized(photo)
    scores, points = found.score_map_2d, found.point_scores
    assert scores is not None
    assert points is not None
    told = ~np.isnan(scores)
    shown = rig_on_sphere(Rig.of_photo(photo)).valid
    shown = shown[:: len(shown) // len(told), :: len(shown) // len(told)]
    assert (told & shown).sum() > 0.95 * told.sum() > 0.9 * 0.95 * shown.sum()
    assert np.nanmedian(scores) > 0.8
    seen = (index.positions.numpy()[~np.isnan(points)] + index.origin_offset - pose.position) @ pose.rotation
    assert len(seen) > 0.03 * len(points)
    ahead, across, up = seen.T
    in_view = (ahead > 0) & (np.abs(across) < 1.3 * ahead) & (np.abs(up) < 1.0 * ahead)  # by 100 degrees, and 84
    assert in_view.mean() > 0.95


# Several photos.


def test_photos_of_another_place_are_never_localized_and_where_up_is_known_even_the_guess_is_level() -> None:
    found = localized(session_of(TWO, up_known=True), OTHER_BOX)
    assert found.status == "not_localized"
    assert session_pose(found).rotation[2, 2] >= np.cos(np.radians(MAX_SESSION_TILT_DEG))


@pytest.mark.parametrize("up_known", [False, True], ids=["in any axes", "up known"])
@pytest.mark.parametrize("poses", [TWO, FOUR], ids=["two", "four"])
def test_photos_from_different_places_are_found_together(poses: tuple[Pose, ...], up_known: bool) -> None:
    found = localized(session_of(poses, up_known=up_known))
    assert found.status == "localized"
    for image, pose in zip(found.images, poses, strict=True):
        error = pose_error(image.pose, MAP_FROM_SESSION.after(pose))
        assert error.within(0.03 if poses is TWO else 0.02, 0.6), f"{error}"  # pixels of the paint are 5 cm wide
        assert known(image.agreement) > 0.85


def test_the_poses_of_all_images_are_one_pose_of_the_session() -> None:
    found = of_four()
    for image, tracked in zip(found.images, SESSION.images, strict=True):
        assert_same(session_pose(found).after(tracked.session_from_camera), image.pose)
    assert_same(best_of(found).pose, found.images[0].pose)
    assert pose_error(session_pose(found), MAP_FROM_SESSION).within(0.02, 0.5)


def test_the_axes_of_a_session_do_not_matter() -> None:
    axes = Pose(rotation_of(70.0, 50.0, 110.0), np.array([5.0, -3.0, 2.0]))
    found = localized(in_axes(SESSION, axes))
    assert_found(found, MAP_FROM_SESSION.after(FOUR[0]), 0.02, 0.5)
    assert pose_error(session_pose(found), MAP_FROM_SESSION.after(axes.inverse())).orientation_deg < 0.5


@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["upright first", "tilted first"])
def test_upright_is_said_of_the_first_image(order: Sequence[int]) -> None:
    poses = TWO[0], replace(TWO[1], rotation=rotation_of(75.0, -6.0, 60.0))
    both = session_of(poses)
    axes = Pose(rotation_of(0.0, 80.0, 30.0), np.zeros(3))  # of a session whose own axes say nothing of what is up
    images = tuple(both.images[number] for number in order)
    found = localized(in_axes(replace(both, images=images), axes), hints=Hints(upright=True))
    truth = MAP_FROM_SESSION.after(poses[order[0]])
    is_right = found.best is not None and pose_error(found.best.pose, truth).within(0.05, 2.0)
    assert is_right is (order[0] == 0)
    if found.best is not None:
        assert found.best.pose.rotation[2, 2] >= np.cos(np.radians(DEFAULT_TOLERANCE_DEG)) - 1e-6


def test_a_photo_of_another_place_among_right_ones_is_told_by_its_agreement() -> None:
    elsewhere = photo_of(SIDEWAYS, Pose(rotation_of(20.0), np.full(3, 1.3)), OTHER_BOX)
    spoilt = Rig((*SESSION.images[:3], RigImage(elsewhere, FOUR[3])))
    found = localized(spoilt)
    assert_found(found, MAP_FROM_SESSION.after(FOUR[0]), 0.05, 1.0)
    *right, wrong = (image.agreement for image in found.images)
    assert wrong is not None
    assert all(each is not None and each > 0.75 > 0.5 > wrong for each in right)


@pytest.mark.parametrize("ahead_m", [0.4, -0.6])
def test_a_session_whose_first_image_has_slipped_is_refused_though_much_of_it_agrees(ahead_m: float) -> None:
    first, *others = SESSION.images
    slipped = first.session_from_camera.after(Pose(np.eye(3), np.array([ahead_m, 0.0, 0.0])))
    found = localized(replace(SESSION, images=(replace(first, session_from_camera=slipped), *others)))
    assert found.status == "not_localized"
    assert [remark.reason for remark in found.warnings] == ["images_contradict"]
    assert known(found.images[0].agreement) > 0.5


def test_a_first_image_that_was_taken_far_from_the_others_is_found_out_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, *others = SESSION.images
    there = MAP_FROM_SESSION.after(first.session_from_camera).after(Pose(rotation_of(-70.0), np.array([0.3, 1.2, 0.0])))
    spoilt = Rig((replace(first, photo=photo_of(SIDEWAYS, there)), *others))
    # Its agreement alone tells it, too: what the scan explains of a painted box seen from elsewhere is next to nothing.
    monkeypatch.setattr(PhotoAgreement, "contradicts", lambda *_: False)
    found = localized(spoilt)
    assert found.status == "not_localized"
    assert [remark.reason for remark in found.warnings] == ["images_contradict"]


def test_an_image_that_slipped_is_asked_with_the_field_of_view_that_all_images_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses = [FOUR[0].after(Pose(np.eye(3), np.array([0.6, 0.0, 0.0]))), *FOUR[1:]]
    photos = [replace(photo_of(SIDEWAYS, MAP_FROM_SESSION.after(pose)), hfov_range_deg=(55.0, 85.0)) for pose in FOUR]
    asked: list[Rig] = []
    run = Engine.run

    def noted(engine: Engine, rig: Rig, *rest: Any) -> Any:
        asked.append(rig)
        return run(engine, rig, *rest)

    monkeypatch.setattr(Engine, "run", noted)
    found = localized(Rig(tuple(RigImage(*each) for each in zip(photos, poses, strict=True))))
    assert found.status == "not_localized"
    _, (alone,) = (rig.photos for rig in asked)
    assert alone.hfov_range_deg is None
    assert alone.camera.hfov_deg == pytest.approx(SIDEWAYS.hfov_deg, abs=5.0)
