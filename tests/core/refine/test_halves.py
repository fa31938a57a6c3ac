"""Halves of a picture, refined apart: they meet where the picture was taken, whatever has changed, and nowhere else."""

from dataclasses import replace

import pytest
import torch

from panoloc.core.config import HalvesConfig, PhotoRefinementConfig
from panoloc.core.refine.halves import halves_apart
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.rig_level import RigLevel
from tests.core.painted_box import PaintedBox
from tests.core.refine.painted_scene import POSITION, ROTATION, photo_with_points

Scene = tuple[RigLevel, CandidatePoints]
STEP = PhotoRefinementConfig().patch_step


@pytest.fixture(scope="module")
def scene() -> Scene:
    return photo_with_points(PaintedBox(seed=3))


def apart(scene: Scene, config: HalvesConfig | None = None) -> tuple[float, float]:
    """Return metres and degrees."""
    found = halves_apart(*scene, ROTATION[0], POSITION[0], STEP, config or HalvesConfig())
    return float(found[0]), float(torch.rad2deg(found[1]))


def with_colors_of_another_box(scene: Scene) -> Scene:
    level, points = scene
    return level, replace(points, colors=photo_with_points(PaintedBox(seed=8))[1].colors)


def test_they_meet_at_the_true_pose(scene: Scene) -> None:
    distance, angle = apart(scene)
    assert distance < 0.003
    assert angle < 0.1


def test_they_part_where_another_place_was_scanned(scene: Scene) -> None:
    distance, angle = apart(with_colors_of_another_box(scene))
    assert distance > 0.05 or angle > 2.0


def test_they_meet_although_a_third_has_changed(scene: Scene) -> None:
    level, points = scene
    other = with_colors_of_another_box(scene)[1]
    assert points.patches is not None
    is_changed = (points.patches % 3 == 0)[None, :, None]
    changed = replace(points, colors=torch.where(is_changed, other.colors, points.colors))
    distance, angle = apart((level, changed))
    assert distance < 0.03
    assert angle < 1.0


def test_halves_in_which_nothing_is_left_do_not_meet(scene: Scene) -> None:
    level, points = scene
    distance, angle = apart((level, replace(points, weights=torch.zeros_like(points.weights))))
    assert distance >= 1.0
    assert angle >= 90.0
