"""Photos of ordinary cameras in a painted box: one alone, and several whose poses among each other are known."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer, why_nothing_fits
from panoloc.core.options import MAX_SESSION_TILT_DEG, Hints
from panoloc.core.panorama.photo import photo_on_sphere
from panoloc.core.panorama.session import Session, SessionImage
from panoloc.core.results import Localization
from tests.core.built_maps import map_of
from tests.core.found_pose import assert_found
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import FOUR, SIDEWAYS, TWO, UPRIGHT, photo_of, session_of
from tests.core.search.symmetric_box import BOX as SYMMETRIC
from tests.core.search.symmetric_box import POSE, TWIN, seen_from_the_other_side

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
WIDE = Camera.from_hfov("pinhole", 640, 480, 100.0)
MAP_FROM_SESSION = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))
CAMERAS = (UPRIGHT, SIDEWAYS, UPRIGHT, SIDEWAYS)


def session(poses: tuple[Pose, ...] = FOUR, up_known: bool = False) -> Session:
    return session_of(PaintedBox(seed=3), MAP_FROM_SESSION, poses, CAMERAS[: len(poses)], up_known)


@pytest.fixture(scope="module")
def found(localizer: Localizer, box_index: MapIndex) -> Localization:
    """Return the answer to four photos."""
    return localizer.localize(session(), [box_index])


def assert_same(found: Pose, expected: Pose) -> None:
    np.testing.assert_allclose(found.position, expected.position, atol=1e-6)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-6)


def in_axes(session: Session, axes: Pose) -> Session:
    """Return the session with poses in other axes of its own."""
    images = (replace(image, session_from_camera=axes.after(image.session_from_camera)) for image in session.images)
    return replace(session, images=tuple(images))


def test_radii_of_several_photos_contain_the_noise_of_their_tracking(localizer: Localizer, box_index: MapIndex) -> None:
    def radii(tracked: Session) -> tuple[float, float]:
        found = localizer.localize(tracked, [box_index])
        assert found.accuracy_position_m is not None
        assert found.accuracy_orientation_deg is not None
        return found.accuracy_position_m, found.accuracy_orientation_deg

    def of_noise(position_m: float, orientation_deg: float) -> Session:
        options = replace(session().options, position_noise_m=position_m, orientation_noise_deg=orientation_deg)
        return replace(session(), options=options)

    silent, noisy = (radii(of_noise(*noise)) for noise in ((1e-6, 1e-6), (0.02, 1.0)))
    assert noisy == pytest.approx([math.hypot(*each) for each in zip(silent, (0.03, 1.0), strict=True)], rel=1e-3)


def test_photos_are_asked_for_their_edges(found: Localization, box_index: MapIndex) -> None:
    assert found.status == "localized"
    strict = replace(CONFIG, judge=replace(CONFIG.judge, least_edges_deg=1e6))
    refused = Localizer(strict, device="cpu").localize(session(), [box_index])
    assert refused.status == "not_localized"
    assert any("next to no edges" in words for words in refused.warnings)


# One photo.


@pytest.mark.parametrize(
    ("hfov_deg", "hints", "form"),
    [(100.0, None, "photo"), (75.0, Hints(upright=True), "photo"), (100.0, None, "masked sphere")],
)
def test_a_photo_is_found_where_it_was_taken(
    localizer: Localizer,
    box: PaintedBox,
    box_index: MapIndex,
    box_pose: Pose,
    hfov_deg: float,
    hints: Hints | None,
    form: str,
) -> None:
    photo = photo_of(box, Camera.from_hfov("pinhole", 640, 480, hfov_deg), box_pose)
    query = photo if form == "photo" else photo_on_sphere(photo.color, photo.valid, photo.camera)
    found = localizer.localize(query, [box_index], hints=hints)
    assert_found(found, box_pose, 0.1, 5.0)


def test_a_photo_of_another_place_is_never_localized(
    localizer: Localizer, other_box_index: MapIndex, box: PaintedBox, box_pose: Pose
) -> None:
    assert localizer.localize(photo_of(box, WIDE, box_pose), [other_box_index]).status == "not_localized"


@pytest.mark.parametrize("form", ["photo", "frames"])
def test_a_room_that_looks_the_same_from_both_sides_is_ambiguous_and_both_are_named(
    localizer: Localizer, form: str
) -> None:
    if form == "photo":
        asked, here, there = Session.of_photo(photo_of(SYMMETRIC, WIDE, POSE)), POSE, TWIN
    else:
        asked = session_of(SYMMETRIC, MAP_FROM_SESSION, FOUR, CAMERAS)
        here = MAP_FROM_SESSION.after(FOUR[0])
        there = seen_from_the_other_side(here)
    found = localizer.localize(asked, [map_of(SYMMETRIC)])
    assert found.status == "ambiguous"
    assert found.best is not None
    named = (found.best.pose, found.alternatives[0].pose)
    for side in (here, there):
        assert any(pose_error(pose, side).within(0.1, 5.0) for pose in named)


def test_a_photo_is_its_own_session(localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose) -> None:
    found = localizer.localize(photo_of(box, WIDE, box_pose), [box_index])
    assert found.best is not None
    assert found.map_from_session is not None
    (image,) = found.images
    assert_same(image.pose, found.best.pose)
    assert_same(found.map_from_session, found.best.pose)
    assert image.agreement is not None
    assert image.agreement > 0.9


def test_of_several_maps_the_one_is_found_in_which_a_photo_was_taken(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, other_box_index: MapIndex, box_pose: Pose
) -> None:
    found = localizer.localize(photo_of(box, WIDE, box_pose), [other_box_index, box_index])
    assert_found(found, box_pose, 0.1, 5.0)
    assert found.best is not None
    assert found.best.map_position == 1


def test_cameras_held_level_are_searched_first_and_others_are_found_as_well(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex
) -> None:
    at = np.array([1.9, 2.2, 1.4])
    level, upside_down = (Pose(rotation_of(*angles), at) for angles in ((70.0, 6.0, -4.0), (70.0, 6.0, 176.0)))
    first, second = (localizer.localize(photo_of(box, WIDE, pose), [box_index]) for pose in (level, upside_down))
    assert_found(first, level, 0.05, 2.0)
    assert_found(second, upside_down, 0.05, 2.0)
    assert first.search.num_poses < second.search.num_poses / 4


def test_what_has_changed_is_told_in_the_axes_of_the_photo(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex
) -> None:
    pose = Pose(rotation_of(70.0, 30.0, 10.0), np.array([1.9, 2.2, 1.4]))
    photo = photo_of(box, WIDE, pose)
    found = localizer.localize(photo, [box_index])
    scores = found.score_map_2d
    assert scores is not None
    known = ~np.isnan(scores)
    shown = photo_on_sphere(photo.color, photo.valid, photo.camera).valid
    shown = shown[:: len(shown) // len(known), :: len(shown) // len(known)]
    assert (known & shown).sum() > 0.95 * known.sum() > 0.9 * 0.95 * shown.sum()
    assert np.nanmedian(scores) > 0.8
    points = found.point_scores
    assert points is not None
    seen = (box_index.positions.numpy()[~np.isnan(points)] + box_index.origin_offset - pose.position) @ pose.rotation
    assert len(seen) > 0.03 * len(points)
    ahead, across, up = seen.T
    in_view = (ahead > 0) & (np.abs(across) < 1.3 * ahead) & (np.abs(up) < 1.0 * ahead)  # by 100 degrees, and 84
    assert in_view.mean() > 0.95


# Several photos.


def test_photos_of_another_place_are_never_localized_and_where_up_is_known_even_the_guess_is_level(
    localizer: Localizer, other_box_index: MapIndex
) -> None:
    found = localizer.localize(session(TWO, up_known=True), [other_box_index])
    assert found.status == "not_localized"
    assert found.map_from_session is not None
    assert found.map_from_session.rotation[2, 2] >= np.cos(np.radians(MAX_SESSION_TILT_DEG))


@pytest.mark.parametrize("up_known", [False, True], ids=["in any axes", "up known"])
@pytest.mark.parametrize("poses", [TWO, FOUR], ids=["two", "four"])
def test_photos_from_different_places_are_found_together(
    localizer: Localizer, box_index: MapIndex, poses: tuple[Pose, ...], up_known: bool
) -> None:
    found = localizer.localize(session(poses, up_known), [box_index])
    assert found.status == "localized"
    for image, pose in zip(found.images, poses, strict=True):
        error = pose_error(image.pose, MAP_FROM_SESSION.after(pose))
        assert error.within(0.03 if poses is TWO else 0.02, 0.6), f"{error}"  # pixels of the paint are 5 cm wide
        assert image.agreement is not None
        assert image.agreement > 0.85


def test_the_poses_of_all_images_are_one_pose_of_the_session(found: Localization) -> None:
    assert found.best is not None
    assert found.map_from_session is not None
    for image, tracked in zip(found.images, session().images, strict=True):
        assert_same(found.map_from_session.after(tracked.session_from_camera), image.pose)
    assert_same(found.best.pose, found.images[0].pose)
    assert pose_error(found.map_from_session, MAP_FROM_SESSION).within(0.02, 0.5)


def test_the_axes_of_a_session_do_not_matter(localizer: Localizer, box_index: MapIndex) -> None:
    axes = Pose(rotation_of(70.0, 50.0, 110.0), np.array([5.0, -3.0, 2.0]))
    found = localizer.localize(in_axes(session(), axes), [box_index])
    assert found.map_from_session is not None
    expected = MAP_FROM_SESSION.after(axes.inverse())
    assert_found(found, MAP_FROM_SESSION.after(FOUR[0]), 0.02, 0.5)
    assert pose_error(found.map_from_session, expected).orientation_deg < 0.5


@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["upright first", "tilted first"])
def test_upright_is_said_of_the_first_image(localizer: Localizer, box_index: MapIndex, order: Sequence[int]) -> None:
    tilted = replace(TWO[1], rotation=rotation_of(75.0, -6.0, 60.0))
    both = session((TWO[0], tilted))
    axes = Pose(rotation_of(0.0, 80.0, 30.0), np.zeros(3))  # of a session whose own axes say nothing of what is up
    images = tuple(both.images[number] for number in order)
    found = localizer.localize(in_axes(replace(both, images=images), axes), [box_index], hints=Hints(upright=True))
    truth = MAP_FROM_SESSION.after((TWO[0], tilted)[order[0]])
    is_right = found.best is not None and pose_error(found.best.pose, truth).within(0.05, 2.0)
    assert is_right is (order[0] == 0)
    if found.best is not None:
        assert found.best.pose.rotation[2, 2] >= np.cos(np.radians(15.0)) - 1e-6


def test_a_photo_of_another_place_among_right_ones_is_told_by_its_agreement(
    localizer: Localizer, box_index: MapIndex
) -> None:
    images = session().images
    elsewhere = photo_of(
        PaintedBox(seed=44, size_m=(4.2, 4.6, 2.5)), SIDEWAYS, Pose(rotation_of(20.0), np.full(3, 1.3))
    )
    spoilt = Session((*images[:3], SessionImage(elsewhere, images[3].session_from_camera)))
    found = localizer.localize(spoilt, [box_index])
    assert_found(found, MAP_FROM_SESSION.after(FOUR[0]), 0.05, 1.0)
    *right, wrong = (image.agreement for image in found.images)
    assert wrong is not None
    assert all(each is not None and each > 0.75 > 0.5 > wrong for each in right)


def test_what_fits_nowhere_is_said_with_what_may_be_wrong() -> None:
    several = session()
    one = Session.of_photo(several.images[0].photo)
    (of_one,), (of_several,) = why_nothing_fits(one, None, False), why_nothing_fits(several, None, False)
    assert "hfov_range_deg" in of_one
    assert "session_from_camera" in of_several
    assert len(why_nothing_fits(one, Hints(upright=True), False)) == 2
    assert why_nothing_fits(one, None, True) == ()  # its field of view was searched already
