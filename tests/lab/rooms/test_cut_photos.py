"""Photos cut out of panoramas show what a camera there shows."""

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, cut_photo, take_panorama, take_photo
from panoloc.lab.rooms.capture.shooting import turned


@pytest.mark.slow
@pytest.mark.parametrize(
    "camera", [Camera.from_hfov("pinhole", 96, 72, 69.0), Camera.from_hfov("cylindrical", 160, 40, 200.0)]
)
def test_a_photo_cut_out_of_a_panorama_is_the_photo_taken_there(room: Scene, pose: Pose, camera: Camera) -> None:
    rotation = turned(0.7, 0.2, -0.1)
    taken = take_photo(room, camera, Pose(rotation, pose.position)).photo
    cut = cut_photo(take_panorama(room, pose, 1024), camera, pose.rotation.T @ rotation)
    assert cut.valid.all()
    difference = np.abs(cut.color.astype(int) - taken.color).mean(-1)
    assert np.median(difference) < 3
    assert (difference < 25).mean() > 0.95
    shifted = np.abs(cut.color[:, 3:].astype(int) - taken.color[:, :-3]).mean(-1)
    assert difference[:, 3:].mean() < 0.6 * shifted.mean()


def test_what_a_panorama_does_not_show_is_masked_in_the_photo() -> None:
    valid = np.ones((32, 64), bool)
    valid[:, :32] = False  # all to the left
    half = Panorama(np.full((32, 64, 3), 200, np.uint8), valid)
    photo = cut_photo(half, Camera.from_hfov("pinhole", 40, 30, 60.0), np.eye(3))
    assert not photo.valid[:, :19].any()
    assert photo.valid[:, 22:].all()
    assert (photo.color[~photo.valid] == 0).all()
    assert (photo.color[photo.valid] == 200).all()


def test_a_fine_panorama_is_averaged_not_skipped_through() -> None:
    stripes = np.zeros((512, 1024, 3), np.uint8)
    stripes[:, ::2] = 255
    photo = cut_photo(
        Panorama(stripes, np.ones((512, 1024), bool)), Camera.from_hfov("pinhole", 20, 15, 60.0), np.eye(3)
    )
    assert np.abs(photo.color.astype(int) - 128).max() < 40
