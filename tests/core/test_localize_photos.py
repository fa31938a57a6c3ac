"""A single photo of an ordinary camera in a painted box."""

import numpy as np
import pytest

from core.camera.camera import Camera
from core.geometry.pose import Pose
from core.index.map_index import MapIndex
from core.localizer import Localizer
from core.options import Hints
from core.panorama.photo import photo_on_sphere
from tests.core.found_pose import assert_found
from tests.core.painted_box import PaintedBox


def photo_of(box: PaintedBox, camera: Camera, pose: Pose) -> np.ndarray:
    """Return what a pinhole at `pose` takes, by its definition."""
    column, row = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    left, up = (camera.cx_px - column) / camera.fx_px, (camera.cy_px - row) / camera.fy_px
    rays = np.stack((np.ones_like(left), left, up), axis=-1).reshape(-1, 3)
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose.rotation.T
    return box.color_along(pose.position, rays).reshape(camera.height_px, camera.width_px, 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hfov_deg", "hints"), [(100.0, None), (75.0, Hints(upright=True))], ids=["wide", "with gravity"]
)
def test_a_photo_is_found_where_it_was_taken(
    localizer: Localizer, box: PaintedBox, box_index: MapIndex, box_pose: Pose, hfov_deg: float, hints: Hints | None
) -> None:
    camera = Camera.from_hfov("pinhole", 640, 480, hfov_deg)
    pixels = photo_of(box, camera, box_pose)
    panorama = photo_on_sphere(pixels, np.ones(pixels.shape[:2], bool), camera)
    found = localizer.localize(panorama, [box_index], hints=hints)
    assert_found(found, box_pose, 0.1, 5.0)


@pytest.mark.slow
def test_a_photo_of_another_place_is_never_localized(
    localizer: Localizer, other_box_index: MapIndex, box: PaintedBox, box_pose: Pose
) -> None:
    camera = Camera.from_hfov("pinhole", 640, 480, 100.0)
    pixels = photo_of(box, camera, box_pose)
    panorama = photo_on_sphere(pixels, np.ones(pixels.shape[:2], bool), camera)
    assert localizer.localize(panorama, [other_box_index]).status == "not_localized"
