"""Photos placed on the sphere, compared with panoramas of the same painted box."""

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.errors import OptionsError, PanoramaUnusableError
from panoloc.core.geometry.pose import Pose
from panoloc.core.panorama.photo import photo_on_sphere
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import photo_of

POSE = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))


@pytest.mark.slow
def test_a_photo_lies_on_the_sphere_where_the_panorama_shows_the_same(box: PaintedBox) -> None:
    camera = Camera.from_hfov("pinhole", 640, 480, 69.0)
    photo = photo_of(box, camera, POSE)
    placed = photo_on_sphere(photo.color, photo.valid, camera)
    whole = box.panorama(POSE, height=placed.valid.shape[0])
    difference = np.abs(placed.color[placed.valid].astype(float) - whole.color[placed.valid])
    assert np.median(difference) < 3
    shifted = np.roll(whole.color, 3, axis=1)
    assert np.abs(placed.color[placed.valid].astype(float) - shifted[placed.valid]).mean() > 2 * difference.mean()


def test_masked_pixels_neither_show_nor_bleed_into_their_neighbours() -> None:
    camera = Camera.from_hfov("pinhole", 4000, 3000, 69.0)
    color = np.full((3000, 4000, 3), 90, np.uint8)
    valid = np.ones((3000, 4000), bool)
    valid[:, 2000:] = False
    color[:, 2000:] = 255
    placed = photo_on_sphere(color, valid, camera)
    assert (placed.color[placed.valid] == 90).all()
    columns = placed.valid.shape[1]
    assert placed.valid[:, : columns // 2 - 2].any()
    assert not placed.valid[:, columns // 2 :].any()


@pytest.mark.slow
def test_a_large_photo_is_averaged_and_not_picked_from() -> None:
    camera = Camera.from_hfov("pinhole", 4000, 3000, 69.0)
    stripes = np.zeros((3000, 4000, 3), np.uint8)
    stripes[:, ::2] = 200
    placed = photo_on_sphere(stripes, np.ones((3000, 4000), bool), camera)
    assert np.abs(placed.color[placed.valid].astype(int) - 100).max() <= 2


def test_intrinsics_of_another_image_are_refused() -> None:
    with pytest.raises(OptionsError, match="got 600 x 800"):
        photo_on_sphere(
            np.zeros((800, 600, 3), np.uint8), np.ones((800, 600), bool), Camera.from_hfov("pinhole", 800, 600, 69.0)
        )


def test_a_photo_of_next_to_nothing_is_refused() -> None:
    with pytest.raises(PanoramaUnusableError, match=r"at least 0\.1%"):
        photo_on_sphere(
            np.zeros((600, 800, 3), np.uint8), np.ones((600, 800), bool), Camera.from_hfov("pinhole", 800, 600, 2.0)
        )
