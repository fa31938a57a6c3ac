"""Defects are drawn where they are said to be, and what finds flat ones finds nearly all of them in a furnished room."""

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama
from panoloc.core.image.invalid_regions import find_missing
from panoloc.lab.evaluation.photo_source import as_uploaded
from panoloc.lab.rooms import View, suite_cases, with_any_defect
from panoloc.lab.rooms.capture.camera_look import PHOTO, CameraLook, apply_look
from panoloc.lab.rooms.capture.defects import DEFECTS, add_defect
from panoloc.lab.rooms.capture.free_space import sample_pose
from panoloc.lab.rooms.capture.views import take_panorama
from panoloc.lab.rooms.scenes.generator import SceneSpec, build_scene

NOT_FLAT = {"logo", "blur", "smear", "mirror"}  # kept, because localization does not suffer


@pytest.fixture(scope="module")
def panorama() -> Panorama:
    scene = build_scene(SceneSpec("room", seed=9))
    pose = sample_pose(scene, np.random.default_rng(9), "upright")
    return apply_look(take_panorama(scene, pose, 1024), PHOTO)


@pytest.mark.slow
@pytest.mark.parametrize("kind", DEFECTS)
def test_a_defect_covers_what_it_says_and_nothing_else(panorama: Panorama, kind: str) -> None:
    spoilt, covered = add_defect(panorama, kind, np.random.default_rng(3))
    again, _ = add_defect(panorama, kind, np.random.default_rng(3))
    assert 0.01 < covered.mean() < 0.8
    assert np.array_equal(spoilt.color, again.color)
    assert spoilt.valid is panorama.valid
    # A rim of a pixel or two may be mixed.
    touched = (spoilt.color != panorama.color).any(axis=-1)
    assert (touched & ~covered).mean() < 0.05
    assert touched[covered].mean() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(set(DEFECTS) - NOT_FLAT))
def test_a_flat_defect_in_a_room_is_found_and_the_room_stays(panorama: Panorama, kind: str) -> None:
    found, lost = [], []
    for seed in range(3):
        spoilt, covered = add_defect(panorama, kind, np.random.default_rng(seed))
        photo = apply_look(spoilt, CameraLook(jpeg_quality=85))  # no noise: software draws after the camera
        missing, _ = find_missing(photo.color, photo.valid, True)
        found.append(missing[covered].mean())
        lost.append(missing[~covered].mean())
    assert np.median(found) > 0.9
    assert np.max(lost) < 0.08


def test_in_a_room_without_a_defect_nothing_is_found(panorama: Panorama) -> None:
    assert find_missing(panorama.color, panorama.valid, True)[1] == ()


def test_what_is_not_covered_by_a_defect_stays_but_for_compression(room_view: View) -> None:
    kinds = set()
    for seed in range(12):
        panorama, covered = with_any_defect(room_view.panorama, np.random.default_rng(seed))
        assert panorama.valid.all()
        assert 0.01 < covered.mean() < 0.75
        difference = np.abs(panorama.color.astype(int) - room_view.panorama.color).mean(-1)
        assert np.median(difference[~covered]) < 4
        kinds.add(round(float(covered.mean()), 3))
    assert len(kinds) > 6


@pytest.mark.slow
def test_the_same_panorama_comes_with_and_without_a_perfect_mask() -> None:
    names = ("rooms/void", "rooms/void_masked")
    untold, masked = (next(suite_cases(name, [2], width=256, num_points=3000)) for name in names)
    assert untold.missing_pixels is not None
    np.testing.assert_array_equal(untold.panorama.color, masked.panorama.color)
    assert untold.panorama.valid.all()
    np.testing.assert_array_equal(masked.panorama.valid, ~untold.missing_pixels)


def test_a_panorama_is_read_as_an_upload_without_losing_its_own_mask(room_view: View) -> None:
    valid = np.ones((256, 512), bool)
    valid[:, :100] = False
    read = as_uploaded(Panorama(room_view.panorama.color, valid))
    assert not read.valid[:, :100].any()
    np.testing.assert_array_equal(read.color, room_view.panorama.color)
