"""Steps patch by patch: what is minimized, light of their own, votes lost to what changed, halves refined apart, and sums over patches."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from panoloc.core.config import HalvesConfig, LineConfig, PhotoRefinementConfig, StepConfig
from panoloc.core.features.line_hold import LineHold
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector
from panoloc.core.refine.gauss_newton import initial_history
from panoloc.core.refine.halves import halves_apart
from panoloc.core.refine.patch_step import PatchStep, patch_step
from panoloc.core.refine.patch_sums import PatchSums
from panoloc.core.refine.refinement import CandidatePoints, refine
from tests.core.features.made_edges import edges_along
from tests.core.other_device import DEVICE, OtherDevice
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


# Halves meet where the picture was taken, whatever has changed, and nowhere else.

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
    is_changed = (PATCHES % 3 == 0)[None, :, None]
    distance, angle = apart(replace(POINTS, colors=torch.where(is_changed, COLORS_ELSEWHERE, POINTS.colors)))
    assert distance < 0.03
    assert angle < 1.0


def test_halves_in_which_nothing_is_left_do_not_meet() -> None:
    distance, angle = apart(replace(POINTS, weights=torch.zeros_like(POINTS.weights)))
    assert distance >= 1.0
    assert angle >= 90.0


# Sums over patches, beside a product with who is where.


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(0, 2**16))
def test_they_are_the_product_with_who_is_where(sizes: list[int], seed: int) -> None:
    patches = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
    values = torch.randn((2, 3, len(patches)), generator=torch.Generator().manual_seed(seed))
    sums = PatchSums(patches)
    expected = values.double() @ torch.nn.functional.one_hot(patches).double()
    torch.testing.assert_close(sums(values).double(), expected, rtol=1e-4, atol=1e-4)
    # Also of planes that do not lie one after the other in memory.
    torch.testing.assert_close(sums(values.transpose(0, 1)), sums(values).transpose(0, 1))
    assert torch.equal(sums.spread(torch.arange(len(sizes))), patches)


@pytest.mark.slow
def test_another_device_adds_them_up_itself() -> None:
    patches, values = torch.tensor([0, 0, 1, 2, 2, 2]), torch.arange(12.0).view(2, 6)
    with torch.no_grad(), OtherDevice():
        there = PatchSums(patches.to(DEVICE))(values.to(DEVICE))
        assert there.device == DEVICE
        torch.testing.assert_close(there.cpu(), torch.tensor([[1.0, 2.0, 12.0], [13.0, 8.0, 30.0]]))


def test_points_that_do_not_follow_each_other_are_refused() -> None:
    with pytest.raises(AssertionError, match="follow each other"):
        PatchSums(torch.tensor([0, 1, 0]))
