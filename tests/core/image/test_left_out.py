"""What is not the place is left out on reading, and reaches the answer in words."""

import numpy as np
import pytest

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.reader import read_image, read_panorama
from tests.core.built_maps import localized, panorama
from tests.core.image.invalid_regions.scenery import scenery
from tests.core.image.picture_files import encoded


def with_void() -> np.ndarray:
    color = scenery()
    color[:220, 300:620] = 0
    color[100:200, 400:800] = 0
    return color


@pytest.mark.parametrize("level", [0, 128, 255])
@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("size", [(128, 64), (1024, 512)], ids=str)
def test_an_image_of_one_colour_is_said_to_show_nothing(level: int, noise: float, size: tuple[int, int]) -> None:
    grain = np.random.default_rng(0).normal(level, noise, (size[1], size[0], 3))
    found = read_panorama(encoded(np.clip(grain, 0, 255).astype(np.uint8), "JPEG"))
    (words,) = found.left_out
    assert words.startswith("the panorama has a single colour and shows no place")
    assert found.valid.all()


def test_a_dark_room_with_one_lamp_is_not_of_one_colour() -> None:
    color = (scenery() // 64).astype(np.uint8)
    color[200:260, 500:560] = 255  # less than a hundredth of the image
    assert read_panorama(encoded(color)).left_out == ()


def test_a_mask_of_the_caller_adds_to_what_is_found() -> None:
    mask = np.zeros((512, 1024), np.uint8)
    mask[400:] = 255
    found = read_panorama(encoded(with_void()), encoded(mask))
    assert not found.valid[400:].any()
    assert not found.valid[20:200, 320:600].any()
    assert found.left_out


def test_what_a_mask_leaves_is_meant_even_where_it_looks_void() -> None:
    mask = np.full((512, 1024), 255, np.uint8)
    mask[20:180, 320:600] = 0
    found = read_panorama(encoded(with_void()), encoded(mask))
    assert found.valid[20:180, 320:600].all()
    assert found.left_out == ()


def test_bars_of_a_photo_are_left_out_and_it_keeps_that_on_the_sphere() -> None:
    color = scenery(640, 480)
    color[:60], color[-60:] = 0, 0  # and two mixed rows beside each
    camera = CameraDescription("pinhole", hfov_deg=70.0)
    photo = read_image(encoded(color), camera=camera)
    assert not photo.valid[:60].any()
    assert photo.valid[70:-70].all()
    assert photo.left_out[0].startswith("26% of the photo is a flat black void")
    assert read_panorama(encoded(color), camera=camera).left_out == photo.left_out


def test_a_full_sphere_that_is_described_as_a_camera_is_called_a_panorama() -> None:
    photo = read_image(encoded(with_void()), camera=CameraDescription("equirectangular"))
    assert "of the panorama is a flat black void" in photo.left_out[0]


def test_several_photos_are_told_apart_by_their_number() -> None:
    clean, spoilt = (
        Photo.of_panorama(Panorama(scenery(), np.ones((512, 1024), np.bool_), words)) for words in ((), ("words",))
    )
    here = Pose(np.eye(3), np.zeros(3))
    assert Rig((RigImage(clean, here), RigImage(spoilt, here))).left_out == ("image 2: words",)
    assert Rig.of_photo(spoilt).left_out == ("words",)


@pytest.mark.slow
def test_an_answer_says_what_was_left_out() -> None:
    spoilt = Panorama(panorama().color, panorama().valid, ("words",))
    assert localized(Rig.of_panorama(spoilt)).warnings == ("words",)
