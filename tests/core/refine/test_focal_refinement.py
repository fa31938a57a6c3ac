"""A pose and a focal length, refined together."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from core.camera.camera import Camera
from core.config import StepConfig
from core.geometry.pose import Pose
from core.panorama.photo_atlas import PhotoAtlas
from core.panorama.photo_colors import equalized_windows
from core.panorama.session import Photo, Session
from core.refine.focal_refinement import FocalRefined, _sampled, refine_with_focal
from core.refine.refinement import CandidatePoints
from core.refine.rig_level import RigLevel
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import photo_of, pinhole_rays

POSE = Pose(rotation_of(25.0, 5.0, -3.0), np.array([1.6, 2.1, 1.4]))


@pytest.fixture(scope="module")
def photo() -> Photo:
    return photo_of(PaintedBox(seed=3), Camera.from_hfov("pinhole", 640, 480, 80.0), POSE)


def level_of(photo: Photo, rows: int = 128) -> RigLevel:
    atlas = PhotoAtlas(Session.of_photo(photo), 512, None, "cpu")
    windows = atlas.windows(rows)
    return RigLevel(windows.level(equalized_windows(windows)), atlas.rotations, atlas.centers)


def points_of(photo: Photo, level: RigLevel) -> CandidatePoints:
    """Return what the photo shows, with the colours that the level has there: at the true pose nothing is left over."""
    box, rays = PaintedBox(seed=3), pinhole_rays(photo.camera)[30:-30:9, 30:-30:9].reshape(-1, 3) @ POSE.rotation.T
    place = torch.tensor(box.points_along(POSE.position, rays), dtype=torch.float32)[None]
    seen, inside = level.sample_points(place.transpose(1, 2), None, *(part[None] for part in tensors(POSE)))
    return CandidatePoints(place, seen.color.transpose(1, 2).clone(), inside.float())


def tensors(pose: Pose) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(pose.rotation, dtype=torch.float32), torch.tensor(pose.position, dtype=torch.float32)


@pytest.mark.parametrize("guessed_deg", [72.0, 80.0, 88.0])
def test_a_wrong_focal_length_is_mended_with_the_pose_that_it_led_to(photo: Photo, guessed_deg: float) -> None:
    points = points_of(photo, level_of(photo))
    guessed = replace(photo, camera=Camera.from_hfov("pinhole", 640, 480, guessed_deg))
    beside = POSE.position + POSE.rotation @ np.array([0.15, 0.05, 0.0])
    begun = FocalRefined(tensors(POSE)[0], torch.tensor(beside, dtype=torch.float32), 1.0)
    found = refine_with_focal(level_of(guessed), points, begun, 20, StepConfig(damping=0.01))
    focal_px = guessed.camera.fx_px * found.focal_factor
    assert focal_px == pytest.approx(photo.camera.fx_px, rel=0.015)
    np.testing.assert_allclose(found.position.numpy(), POSE.position, atol=0.04)


def test_the_derivatives_are_those_of_where_points_are_looked_up(photo: Photo) -> None:
    level = level_of(photo)
    place = points_of(photo, level).positions.transpose(1, 2)
    rotation, position = tensors(POSE)
    spread = torch.tensor(0.06)
    seen, _ = _sampled(level, place, rotation, position, spread)
    local = (rotation.T @ (place[0] - position[:, None])).double()

    def looked_up(factor: float, turn: torch.Tensor, move: torch.Tensor) -> torch.Tensor:
        x, y, z = local - torch.linalg.cross(turn[:, None].expand(-1, local.shape[1]), local, dim=0) - move[:, None]
        y, z = y * factor, z * factor
        return torch.stack((torch.atan2(y, x), torch.atan2(z, torch.hypot(x, y))))

    nothing, small = torch.zeros(3, dtype=torch.float64), 1e-6
    for k in range(7):
        change = torch.zeros(7, dtype=torch.float64)
        change[k] = small
        after, before = (
            looked_up(
                math.exp(0.06 + sign * float(change[6])), nothing + sign * change[:3], nothing + sign * change[3:6]
            )
            for sign in (1, -1)
        )
        expected = (after - before) / (2 * small)
        np.testing.assert_allclose(seen.directions[0, k].double().numpy(), expected.numpy(), atol=2e-3)
