"""The images of a rig on one sphere, against what a panorama shows at the same place."""

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_window import rig_on_sphere
from tests.core.built_maps import BOX, POSE
from tests.core.image.painted_photos import SIDEWAYS, UPRIGHT, photo_of
from tests.core.painted_box import rotation_of

PLACE = np.array([0.5, -1.0, 2.0])


def test_images_from_one_place_are_put_together_to_what_a_panorama_shows_there() -> None:
    turns = rotation_of(10.0, 3.0), rotation_of(60.0, -10.0, 20.0), rotation_of(-100.0, 5.0)
    images = []
    for camera, turn in zip((UPRIGHT, SIDEWAYS, UPRIGHT), turns, strict=True):
        photo = photo_of(camera, POSE.after(Pose(turn, np.zeros(3))))
        images.append(RigImage(photo, Pose(turn, PLACE)))
    rig = Rig(tuple(images))
    sphere, pose = rig_on_sphere(rig), rig.session_from_rig
    np.testing.assert_array_equal(pose.rotation, np.eye(3))
    np.testing.assert_allclose(pose.position, PLACE)
    whole = BOX.panorama(POSE, len(sphere.valid))
    off = np.abs(sphere.color[sphere.valid].astype(float) - whole.color[sphere.valid])
    assert np.median(off) < 3
    ahead = np.stack([turn[:, 0] for turn in turns])
    # The middle of each image is shown, and nothing behind all of them.
    elevation, azimuth = np.arcsin(ahead[:, 2]), np.arctan2(ahead[:, 1], ahead[:, 0])
    rows = len(sphere.valid)
    at = ((0.5 - elevation / np.pi) * rows).astype(int), ((1 - azimuth / np.pi) * rows).astype(int)
    assert sphere.valid[at].all()
    assert not sphere.valid[rows // 2, round((1 - np.radians(160) / np.pi) * rows)]


def test_where_images_overlap_the_one_whose_middle_is_nearest_is_shown() -> None:
    images = []
    for value, yaw in ((40, 20.0), (200, -20.0)):
        color = np.full((360, 480, 3), value, np.uint8)
        images.append(RigImage(Photo(color, np.ones((360, 480), bool), SIDEWAYS), Pose(rotation_of(yaw), PLACE)))
    sphere = rig_on_sphere(Rig(tuple(images)))
    rows = len(sphere.valid)
    horizon = sphere.color[rows // 2, rows - rows // 18 : rows + rows // 18, 0]  # ten degrees to each side
    middle = len(horizon) // 2
    assert set(horizon[: middle - 1]) == {40}  # the left one's
    assert set(horizon[middle + 1 :]) == {200}


def test_a_panorama_stays_as_it_is_and_goes_along_with_a_turn_of_its_camera() -> None:
    panorama = BOX.panorama(POSE, 64)
    rig = Rig.of_panorama(panorama)
    np.testing.assert_array_equal(rig_on_sphere(rig).color, panorama.color)
    np.testing.assert_array_equal(rig.session_from_rig.position, np.zeros(3))
    turned = Rig((RigImage(Photo.of_panorama(panorama), Pose(rotation_of(90.0), PLACE)),))
    found = rig_on_sphere(turned)
    np.testing.assert_array_equal(found.color, np.roll(panorama.color, -32, axis=1))
    assert found.valid.all()


# A single photo.

LARGE = Camera.from_hfov("pinhole", 4000, 3000, 69.0)


@pytest.mark.slow
def test_a_photo_lies_on_the_sphere_where_the_panorama_shows_the_same() -> None:
    photo = photo_of(Camera.from_hfov("pinhole", 640, 480, 69.0))
    placed = on_sphere(photo)
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
    placed = on_sphere(Photo(color, valid, LARGE))
    assert (placed.color[placed.valid] == 90).all()
    columns = placed.valid.shape[1]
    assert placed.valid[:, : columns // 2 - 2].any()
    assert not placed.valid[:, columns // 2 :].any()


@pytest.mark.slow
def test_a_large_photo_is_averaged_and_not_picked_from() -> None:
    stripes = np.zeros((3000, 4000, 3), np.uint8)
    stripes[:, ::2] = 200
    placed = on_sphere(Photo(stripes, np.ones((3000, 4000), bool), LARGE))
    assert np.abs(placed.color[placed.valid].astype(int) - 100).max() <= 2


@pytest.mark.parametrize("rows", [512, 515])
def test_a_panorama_that_is_made_smaller_has_the_rows_asked_for_and_nothing_of_it_moves(rows: int) -> None:
    panorama = np.zeros((rows, 2 * rows, 3), np.uint8)
    panorama[rows // 2 :, rows:] = 200  # sharp in the middle of both sides
    found = rig_on_sphere(Rig.of_panorama(Panorama(panorama, np.ones((rows, 2 * rows), bool))), 256).color
    assert found.shape == (256, 512, 3)
    assert found[:127].max() == found[:, :255].max() == 0
    assert found[129:, 257:].min() == 200


def on_sphere(photo: Photo) -> Panorama:
    return rig_on_sphere(Rig.of_photo(photo))
