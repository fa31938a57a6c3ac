"""Halves of a picture, refined apart: they meet where the picture was taken, whatever has changed, and nowhere else."""

from dataclasses import replace

import torch

from panoloc.core.config import HalvesConfig, PhotoRefinementConfig
from panoloc.core.refine.halves import halves_apart
from panoloc.core.refine.refinement import CandidatePoints
from tests.core.refine.painted_scene import POSITION, ROTATION, patches_of, scene

LEVEL, POINTS = scene()
COLORS_ELSEWHERE = scene(seed=8)[1].colors


def apart(points: CandidatePoints) -> tuple[float, float]:
    """Return metres and degrees."""
    step = PhotoRefinementConfig().patch_step
    found = halves_apart(LEVEL, points, ROTATION[0], POSITION[0], step, HalvesConfig())
    return float(found[0]), float(torch.rad2deg(found[1]))


def test_they_meet_at_the_true_pose() -> None:
    distance, angle = apart(POINTS)
    assert distance < 0.003
    assert angle < 0.1


def test_they_part_where_another_place_was_scanned() -> None:
    distance, angle = apart(replace(POINTS, colors=COLORS_ELSEWHERE))
    assert distance > 0.05 or angle > 2.0


def test_they_meet_although_a_third_has_changed() -> None:
    is_changed = (patches_of(POINTS) % 3 == 0)[None, :, None]
    distance, angle = apart(replace(POINTS, colors=torch.where(is_changed, COLORS_ELSEWHERE, POINTS.colors)))
    assert distance < 0.03
    assert angle < 1.0


def test_halves_in_which_nothing_is_left_do_not_meet() -> None:
    distance, angle = apart(replace(POINTS, weights=torch.zeros_like(POINTS.weights)))
    assert distance >= 1.0
    assert angle >= 90.0
