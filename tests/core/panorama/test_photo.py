"""Photos placed on the sphere, compared with panoramas of the same painted box."""

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.errors import OptionsError
from panoloc.core.panorama.photo import photo_on_sphere
from tests.core.built_maps import BOX, POSE
from tests.core.panorama.painted_photos import photo_of

CAMERA = Camera.from_hfov("pinhole", 4000, 3000, 69.0)


@pytest.mark.slow
def test_a_photo_lies_on_the_sphere_where_the_panorama_shows_the_same() -> None:
    photo = photo_of(Camera.from_hfov("pinhole", 640, 480, 69.0))
    placed = photo_on_sphere(photo.color, photo.valid, photo.camera)
    whole = BOX.panorama(POSE, height=placed.valid.shape[0])
    difference = np.abs(placed.color[placed.valid].astype(float) - whole.color[placed.valid])
    assert np.median(difference) < 3
    shifted = np.roll(whole.color, 3, axis=1)
    assert np.abs(placed.color[placed.valid].astype(float) - shifted[placed.valid]).mean() > 2 * difference.mean()


def test_masked_pixels_neither_show_nor_bleed_into_their_neighbours() -> None:
    color = np.full((3000, 4000, 3), 90, np.uint8)
    valid = np.ones((3000, 4000), bool)
    valid[:, 2000:] = False
    color[:, 2000:] = 255
    placed = photo_on_sphere(color, valid, CAMERA)
    assert (placed.color[placed.valid] == 90).all()
    columns = placed.valid.shape[1]
    assert placed.valid[:, : columns // 2 - 2].any()
    assert not placed.valid[:, columns // 2 :].any()


@pytest.mark.slow
def test_a_large_photo_is_averaged_and_not_picked_from() -> None:
    stripes = np.zeros((3000, 4000, 3), np.uint8)
    stripes[:, ::2] = 200
    placed = photo_on_sphere(stripes, np.ones((3000, 4000), bool), CAMERA)
    assert np.abs(placed.color[placed.valid].astype(int) - 100).max() <= 2


def test_intrinsics_of_another_image_are_refused() -> None:
    with pytest.raises(OptionsError, match="got 600 x 800"):
        photo_on_sphere(np.zeros((800, 600, 3), np.uint8), np.ones((800, 600), bool), CAMERA)
