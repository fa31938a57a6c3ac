"""Steps patch by patch: what is minimized, light of their own, and votes lost to what changed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.config import LineConfig, PhotoRefinementConfig, StepConfig
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector
from panoloc.core.lines.line_hold import LineHold
from panoloc.core.refine.gauss_newton import initial_history
from panoloc.core.refine.patch_step import PatchStep, patch_step
from panoloc.core.refine.refinement import refine
from tests.core.lines.made_edges import edges_along
from tests.core.refine.painted_scene import POSITION, ROTATION, patches_of, scene

PLAIN = PhotoRefinementConfig().patch_step
LEVEL, POINTS = scene()
PATCHES = patches_of(POINTS)
RULES = replace(PLAIN, patch_robust_scale=2.0)


def moved(turn: tuple[float, float, float], move: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    return ROTATION @ rotation_from_vector(torch.tensor([turn])), POSITION + torch.tensor([move]) @ ROTATION[0].T


def step_at(pose: tuple[Tensor, Tensor]) -> PatchStep:
    return patch_step(LEVEL, POINTS.planes(), *pose, initial_history(1, PLAIN, torch.device("cpu")), PLAIN, False)


def off_by(found: tuple[Tensor, Tensor]) -> float:
    return float((found[1] - POSITION).norm())


def test_at_the_true_pose_nothing_is_left_to_explain() -> None:
    step = step_at((ROTATION, POSITION))
    beside = step_at(moved((0.0, 0.0, 0.0), (0.1, 0.1, 0.0)))
    assert float(step.loss) < float(beside.loss) / 3 < 1
    assert float(step.history.step.norm()) < 1e-3


def test_the_slope_is_that_of_the_contrast_that_is_not_explained() -> None:
    pose = moved((0.01, -0.02, 0.015), (0.04, 0.03, -0.02))
    step = step_at(pose)
    turn, move = step.history.step[:, :3], step.history.step[:, 3:]
    small = 0.02

    def loss_along(share: float) -> float:
        there = pose[0] @ rotation_from_vector(share * turn), pose[1] + (pose[0] @ (share * move)[..., None])[..., 0]
        return float(step_at(there).loss)

    rise = (loss_along(small) - loss_along(-small)) / (2 * small)
    mass = float(POINTS.weights.sum())
    assert rise < 0
    assert float(step.history.slope) / mass == pytest.approx(rise, rel=0.15)


def test_each_patch_may_have_a_light_of_its_own() -> None:
    rng = torch.Generator().manual_seed(5)
    count = int(PATCHES.max()) + 1
    gain, offset = 0.5 + torch.rand(count, 1, generator=rng), torch.rand(count, 3, generator=rng) - 0.5
    lit = replace(POINTS, colors=POINTS.colors * gain[PATCHES] + offset[PATCHES])
    begun = moved((0.02, -0.03, 0.02), (0.1, 0.05, -0.05))
    found = refine(LEVEL, lit, *begun, 20, RULES)
    assert off_by((found.rotations, found.positions)) < 0.01


def test_what_moved_in_most_of_a_photo_drags_single_points_along_but_not_patches() -> None:
    # In two patches of three everything stands elsewhere than the scan says, each by a way of its own; and each has its lamp.
    rng = torch.Generator().manual_seed(2)
    count = int(PATCHES.max()) + 1
    away = torch.randn(count, 3, generator=rng) * 0.4 * (torch.arange(count) % 3 > 0)[:, None]
    gain = 0.4 + torch.rand(count, 1, generator=rng)
    colors = POINTS.colors * gain[PATCHES]
    changed = replace(POINTS, positions=POINTS.positions + away[PATCHES], colors=colors)
    begun = moved((0.01, -0.02, 0.01), (0.06, 0.04, -0.03))
    by_patches = refine(LEVEL, changed, *begun, 20, RULES)
    by_points = refine(LEVEL, replace(changed, patches=None), *begun, 20, StepConfig(robust_scale=1.5))
    assert off_by((by_patches.rotations, by_patches.positions)) < 0.03
    assert off_by((by_points.rotations, by_points.positions)) > 0.06


def test_lines_turn_a_pose_that_colors_leave_free() -> None:
    plain = replace(POINTS, colors=torch.full_like(POINTS.colors, 0.5))
    turned = moved((0.03, -0.02, 0.03), (0.0, 0.0, 0.0))
    free = refine(LEVEL, plain, *turned, 10, PLAIN)
    edges = edges_along(ROTATION[0])  # of a map whose walls are along its axes
    hold = LineHold(edges, torch.eye(3)[None], torch.ones(1), LineConfig())
    held = refine(LEVEL, replace(plain, lines=hold), *turned, 10, PLAIN)
    assert float(rotation_angle(free.rotations, ROTATION)) > np.radians(2.0)
    assert float(rotation_angle(held.rotations, ROTATION)) < np.radians(0.4)


def test_without_points_in_view_a_pose_stays_where_it_is() -> None:
    nothing = replace(POINTS, weights=torch.zeros_like(POINTS.weights))
    found = refine(LEVEL, nothing, ROTATION, POSITION, 4, RULES)
    torch.testing.assert_close(found.positions, POSITION)
    assert torch.isfinite(found.hessian).all()
