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
from panoloc.core.refine.refinement import CandidatePoints, refine
from panoloc.core.refine.rig_level import RigLevel
from tests.core.lines.made_edges import edges_along
from tests.core.painted_box import PaintedBox
from tests.core.refine.painted_scene import POSITION, ROTATION, photo_with_points

PLAIN = PhotoRefinementConfig().patch_step
RULES = replace(PLAIN, patch_robust_scale=2.0)


@pytest.fixture(scope="module")
def scene() -> tuple[RigLevel, CandidatePoints]:
    return photo_with_points(PaintedBox(seed=3))


def moved(turn: tuple[float, float, float], move: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    return ROTATION @ rotation_from_vector(torch.tensor([turn])), POSITION + torch.tensor([move]) @ ROTATION[0].T


def step_at(scene: tuple[RigLevel, CandidatePoints], pose: tuple[Tensor, Tensor], rules: StepConfig) -> PatchStep:
    level, points = scene
    return patch_step(level, points.planes(), *pose, initial_history(1, rules, torch.device("cpu")), rules, False)


def off_by(found: tuple[Tensor, Tensor]) -> float:
    return float((found[1] - POSITION).norm())


def test_at_the_true_pose_nothing_is_left_to_explain(scene: tuple[RigLevel, CandidatePoints]) -> None:
    step = step_at(scene, (ROTATION, POSITION), PLAIN)
    beside = step_at(scene, moved((0.0, 0.0, 0.0), (0.1, 0.1, 0.0)), PLAIN)
    assert float(step.loss) < float(beside.loss) / 3 < 1
    assert float(step.history.step.norm()) < 1e-3


def test_the_slope_is_that_of_the_contrast_that_is_not_explained(scene: tuple[RigLevel, CandidatePoints]) -> None:
    pose = moved((0.01, -0.02, 0.015), (0.04, 0.03, -0.02))
    step = step_at(scene, pose, PLAIN)
    turn, move = step.history.step[:, :3], step.history.step[:, 3:]
    small = 0.02

    def loss_along(share: float) -> float:
        there = pose[0] @ rotation_from_vector(share * turn), pose[1] + (pose[0] @ (share * move)[..., None])[..., 0]
        return float(step_at(scene, there, PLAIN).loss)

    rise = (loss_along(small) - loss_along(-small)) / (2 * small)
    mass = float(scene[1].weights.sum())
    assert rise < 0
    assert float(step.history.slope) / mass == pytest.approx(rise, rel=0.15)


def test_each_patch_may_have_a_light_of_its_own(scene: tuple[RigLevel, CandidatePoints]) -> None:
    level, points = scene
    assert points.patches is not None
    rng = torch.Generator().manual_seed(5)
    count = int(points.patches.max()) + 1
    gain, offset = 0.5 + torch.rand(count, 1, generator=rng), torch.rand(count, 3, generator=rng) - 0.5
    lit = replace(points, colors=points.colors * gain[points.patches] + offset[points.patches])
    begun = moved((0.02, -0.03, 0.02), (0.1, 0.05, -0.05))
    found = refine(level, lit, *begun, 20, RULES)
    assert off_by((found.rotations, found.positions)) < 0.01


def test_what_moved_in_most_of_a_photo_drags_single_points_along_but_not_patches(
    scene: tuple[RigLevel, CandidatePoints],
) -> None:
    level, points = scene
    assert points.patches is not None
    # In two patches of three everything stands elsewhere than the scan says, each by a way of its own; and each has its lamp.
    rng = torch.Generator().manual_seed(2)
    count = int(points.patches.max()) + 1
    away = torch.randn(count, 3, generator=rng) * 0.4 * (torch.arange(count) % 3 > 0)[:, None]
    gain = 0.4 + torch.rand(count, 1, generator=rng)
    colors = points.colors * gain[points.patches]
    changed = replace(points, positions=points.positions + away[points.patches], colors=colors)
    begun = moved((0.01, -0.02, 0.01), (0.06, 0.04, -0.03))
    by_patches = refine(level, changed, *begun, 20, RULES)
    by_points = refine(level, replace(changed, patches=None), *begun, 20, StepConfig(robust_scale=1.5))
    assert off_by((by_patches.rotations, by_patches.positions)) < 0.03
    assert off_by((by_points.rotations, by_points.positions)) > 0.06


def test_lines_turn_a_pose_that_colors_leave_free(scene: tuple[RigLevel, CandidatePoints]) -> None:
    level, points = scene
    plain = replace(points, colors=torch.full_like(points.colors, 0.5))
    turned = moved((0.03, -0.02, 0.03), (0.0, 0.0, 0.0))
    free = refine(level, plain, *turned, 10, PLAIN)
    edges = edges_along(ROTATION[0])  # of a map whose walls are along its axes
    hold = LineHold(edges, torch.eye(3)[None], torch.ones(1), LineConfig())
    held = refine(level, replace(plain, lines=hold), *turned, 10, PLAIN)
    assert float(rotation_angle(free.rotations, ROTATION)) > np.radians(2.0)
    assert float(rotation_angle(held.rotations, ROTATION)) < np.radians(0.4)


def test_without_points_in_view_a_pose_stays_where_it_is(scene: tuple[RigLevel, CandidatePoints]) -> None:
    level, points = scene
    nothing = replace(points, weights=torch.zeros_like(points.weights))
    found = refine(level, nothing, ROTATION, POSITION, 4, RULES)
    torch.testing.assert_close(found.positions, POSITION)
    assert torch.isfinite(found.hessian).all()
