"""A pose and a focal length, refined together."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.config import RefinementConfig
from panoloc.core.image.level import Level
from panoloc.core.refine.focal_refinement import FocalRefined, refine_with_focal
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.step import patch_equations
from tests.core.built_maps import BOX
from tests.core.refine.painted_scene import CAMERA, POSE, POSITION, ROTATION, level_of, scene

STEP = RefinementConfig().step


def level_as(hfov_deg: float) -> tuple[Level, Camera]:
    """Return the photo of the scene as one of another camera."""
    guessed = Camera.from_hfov("pinhole", 640, 480, hfov_deg)
    return level_of(BOX, guessed)[0], guessed


def refined(points: CandidatePoints, guessed_deg: float, iterations: int = 20) -> tuple[float, FocalRefined]:
    """Return the focal length that is found over the true one, and all that is."""
    level, guessed = level_as(guessed_deg)
    beside = torch.tensor(POSE.position + POSE.rotation @ np.array([0.15, 0.05, 0.0]), dtype=torch.float32)
    found = refine_with_focal(level, points, FocalRefined.at(ROTATION[0], beside), iterations, STEP)
    return guessed.fx_px * math.exp(float(found.log_factor)) / CAMERA.fx_px, found


@pytest.mark.parametrize("guessed_deg", [66.0, 80.0, 94.0])
def test_a_wrong_focal_length_is_mended_with_the_pose_that_it_led_to(guessed_deg: float) -> None:
    factor, found = refined(scene()[1], guessed_deg)
    assert factor == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(found.position.numpy(), POSE.position, atol=0.03)


def test_it_is_mended_although_most_of_the_room_has_changed() -> None:
    points, other = scene()[1], scene(seed=8)[1]
    is_changed = (points.patches % 5 > 1)[None, :, None]
    changed = replace(points, colors=torch.where(is_changed, other.colors, points.colors))
    factor, found = refined(changed, 88.0)
    assert factor == pytest.approx(1.0, abs=0.03)
    assert float(found.information) < float(refined(points, 88.0)[1].information)


def test_a_known_focal_length_is_hardly_pulled_at() -> None:
    begun = FocalRefined.at(ROTATION[0], POSITION[0])
    right, wrong = (refine_with_focal(level_as(deg)[0], scene()[1], begun, 3, STEP) for deg in (80.0, 70.0))
    assert right.strength < 0.01
    assert wrong.strength > 0.2


def test_of_a_plain_wall_nothing_is_known() -> None:
    points = scene()[1]
    found = refined(replace(points, colors=torch.full_like(points.colors, 0.5)), 80.0, 4)[1]
    assert float(found.information) == pytest.approx(0.0, abs=1e-3)
    assert torch.isfinite(found.position).all()


def test_the_slope_by_the_focal_length_is_that_of_the_loss() -> None:
    level, points = scene()

    def equations(log_focal: float) -> tuple[float, float]:
        found = patch_equations(level, points.planes(), ROTATION, POSITION, STEP, torch.tensor(log_focal))
        return float(found.loss[0]), float(found.gradient[0, 6] / found.mass[0])

    small = 0.002
    rise = (equations(0.05 + small)[0] - equations(0.05 - small)[0]) / (2 * small)
    assert rise > 0
    # Derivatives of a picture are over two of its pixels, which makes them a fifth smaller where it is sharp.
    assert equations(0.05)[1] == pytest.approx(rise, rel=0.25)
