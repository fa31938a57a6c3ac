"""Photos of a question: small ones on the sphere, and images as uploaded, with the camera of their answer."""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from panoloc.core.changes.__main__ import photo_of

TIME = "2026-11-21T12:00:00Z"
SQUARE = {"model": "pinhole", "hfov_deg": 90.0}


def uploaded(folder: Path, size: tuple[int, int], **given: Any) -> dict[str, Any]:
    """Return the question of a red image."""
    Image.new("RGB", size, (200, 10, 10)).save(folder / "image", "PNG")
    pose = {"position_m": [1.0, 2.0, 3.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "frame": "ros"}
    return {"image": str(folder / "image"), "time": TIME, "camera": None, **pose, **given}


def test_an_uploaded_panorama_becomes_a_small_one(tmp_path: Path) -> None:
    sphere = {"model": "equirectangular", "hfov_deg": 360.0}
    found = photo_of(uploaded(tmp_path, (2048, 1024), found_camera=sphere))
    assert found.panorama.color.shape == (512, 1024, 3)
    assert found.panorama.valid.all()
    np.testing.assert_allclose(found.pose.position, [1.0, 2.0, 3.0])


def test_an_uploaded_photo_lies_on_the_sphere_as_wide_as_it_was_found(tmp_path: Path) -> None:
    searched = {"model": "pinhole", "hfov_range_deg": (60.0, 110.0)}
    for camera in (None, searched):
        found = photo_of(uploaded(tmp_path, (400, 400), found_camera=SQUARE, camera=camera))
        rows, columns = found.panorama.valid.shape
        assert abs(found.panorama.valid[rows // 2].sum() / columns - 0.25) < 0.01
        assert found.panorama.color[rows // 2, columns // 2, 0] > 150


def test_the_pose_is_in_the_axes_of_the_answer(tmp_path: Path) -> None:
    found = photo_of(uploaded(tmp_path, (400, 400), found_camera=SQUARE, frame="webxr"))
    np.testing.assert_allclose(found.pose.position, [1.0, -3.0, 2.0])
