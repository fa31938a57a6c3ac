"""Defects are drawn where they are said to be, and what finds them finds nearly all of them in a furnished room."""

import numpy as np
import pytest

from core.panorama.missing.finding import find_missing
from core.panorama.panorama import Panorama
from lab.rooms.capture.camera_look import PHOTO, CameraLook, apply_look
from lab.rooms.capture.defects import DEFECT_KINDS, DefectKind, add_defect
from lab.rooms.capture.free_space import sample_pose
from lab.rooms.capture.spherical_camera import take_panorama
from lab.rooms.scenes.generator import SceneSpec, build_scene


@pytest.fixture(scope="module")
def panorama() -> Panorama:
    scene = build_scene(SceneSpec("room", seed=9))
    pose = sample_pose(scene, np.random.default_rng(9), "upright")
    return apply_look(take_panorama(scene, pose, 1024), PHOTO)


@pytest.mark.slow
@pytest.mark.parametrize("kind", DEFECT_KINDS)
def test_a_defect_covers_what_it_says_and_nothing_else(panorama: Panorama, kind: DefectKind) -> None:
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
@pytest.mark.parametrize("kind", DEFECT_KINDS)
def test_a_defect_in_a_room_is_found_and_the_room_stays(panorama: Panorama, kind: DefectKind) -> None:
    found, lost = [], []
    for seed in range(4):
        spoilt, covered = add_defect(panorama, kind, np.random.default_rng(seed))
        photo = apply_look(spoilt, CameraLook(jpeg_quality=85))  # no noise: software draws after the camera
        missing = find_missing(photo.color, photo.valid, True).missing
        # A ceiling without texture looks the same in a mirror: of what is filled at both poles the floor is asked for.
        asked = covered & (np.arange(512)[:, None] >= (256 if kind in ("smear", "mirror") else 0))
        found.append(missing[asked].mean())
        lost.append(missing[~covered].mean())
    assert np.median(found) > 0.9
    assert np.max(lost) < 0.08


@pytest.mark.slow
def test_a_room_without_a_defect_stays_whole(panorama: Panorama) -> None:
    assert find_missing(panorama.color, panorama.valid, True).words == ()
