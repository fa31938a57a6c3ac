"""Refinement on an image painted by a formula and in a painted box, at poses that are known, and within limits of tilt."""

import math
from dataclasses import replace

import pytest
import torch

from panoloc.core.config import RefinementConfig, StepConfig
from panoloc.core.geometry.rotations import even_directions, rotation_angle, rotation_from_vector, uniform_rotations
from panoloc.core.refine.patches import patch_numbers
from panoloc.core.refine.refinement import Refined, refine
from panoloc.core.refine.step import PointPlanes, patch_equations
from panoloc.core.search.pose_limits import PoseLimits
from tests.core.refine import painted_scene
from tests.core.refine.painted_scene import at_distances, level_of_sphere, painted, painted_sphere

HEIGHT = 128
STEP = RefinementConfig().step
ROTATION, POSITION = uniform_rotations(11)[4], torch.tensor([0.5, -1.0, 1.2])
PATCHES, ORDER = patch_numbers(even_directions(3000), 22.5).sort(stable=True)
IMAGE, DIRECTIONS = painted_sphere(HEIGHT), even_directions(3000)[ORDER]
# What the image shows, without errors of parallax.
POINTS = PointPlanes.of_triples(
    (POSITION + at_distances(DIRECTIONS) @ ROTATION.T)[None],
    painted(DIRECTIONS)[None],
    torch.ones((1, 3000)),
    None,
    PATCHES,
)
BESIDE = POSITION + torch.tensor([0.15, -0.15, 0.1])


def off_by(
    image: torch.Tensor = IMAGE,
    points: PointPlanes = POINTS,
    valid: torch.Tensor | None = None,
    rules: StepConfig = STEP,
) -> tuple[float, float]:
    """Return how many metres and degrees the pose is off after refinement from one that is 0.25 m and 9 degrees off."""
    start = ROTATION @ rotation_from_vector(torch.tensor([0.1, -0.1, 0.07]))
    found = refine(level_of_sphere(image, valid), points, start[None], BESIDE[None], 25, rules)
    angle = rotation_angle(found.rotations[0].double(), ROTATION.double())
    return float((found.positions[0] - POSITION).norm()), math.degrees(float(angle))


def test_refinement_does_not_mind_gain_and_offset() -> None:
    metres, degrees = off_by(IMAGE * 0.7 + torch.tensor([0.05, 0.2, 0.0])[:, None, None])
    assert metres < 0.005
    assert degrees < 0.1


def test_points_that_changed_here_and_there_lose_their_vote() -> None:
    changed = POINTS.colors.clone()
    changed[..., ::3] = torch.rand((1000, 3), generator=torch.Generator().manual_seed(3)).T
    some = replace(POINTS, colors=changed)
    metres, degrees = off_by(points=some, rules=replace(STEP, robust_scale=2.0))
    assert metres < 0.03
    assert degrees < 0.6
    assert off_by(points=some, rules=STEP)[1] > 2.0


def test_refinement_ignores_what_is_masked() -> None:
    valid = torch.ones((HEIGHT, 2 * HEIGHT))
    valid[40:100, 30:160] = 0
    metres, degrees = off_by(torch.where(valid.bool(), IMAGE, torch.ones(())), valid=valid)
    assert metres < 0.01
    assert degrees < 0.2


def test_longer_steps_are_nearer_to_the_pose_where_noise_makes_plain_ones_creep() -> None:
    noisy = IMAGE + 0.02 * torch.randn(IMAGE.shape, generator=torch.Generator().manual_seed(5))
    level = level_of_sphere(noisy)
    longer, plain = (
        float((refine(level, POINTS, ROTATION[None], BESIDE[None], 8, config).positions[0] - POSITION).norm())
        for config in (STEP, replace(STEP, lengthening=1.0))
    )
    assert longer < 0.8 * plain


# Within limits of tilt, of a photo that is tilted by 5.8 degrees.

LEVEL, SEEN = painted_scene.scene()
TRUE = painted_scene.ROTATION, painted_scene.POSITION


def tilt_deg(rotations: torch.Tensor) -> float:
    """Return the largest angle between the up axes of cameras and that of the map."""
    up = torch.nn.functional.normalize(rotations.double()[:, :, 2], dim=-1)
    return math.degrees(math.acos(float(up[:, 2].clamp(-1, 1).min())))


def within(most_deg: float) -> PoseLimits:
    return PoseLimits(max_tilt=math.radians(most_deg))


def refined(most_deg: float | None = None, iterations: int = 20, tilted: float = 0.0) -> Refined:
    """Refine from poses beside the true one, the second of them turned further off by `tilted` radians."""
    turns = rotation_from_vector(torch.tensor([[0.02, -0.03, 0.02], [tilted, 0.02, -0.01]]))
    positions = TRUE[1] + torch.tensor([[0.1, 0.05, -0.05], [-0.05, 0.1, 0.05]])
    both = SEEN.take(torch.zeros(2, dtype=torch.int64))
    back = None if most_deg is None else within(most_deg).nearest_rotations
    return refine(LEVEL, both, TRUE[0] @ turns, positions, iterations, STEP, within=back)


@pytest.mark.parametrize("iterations", [1, 2, 20])
def test_no_step_leads_beyond_a_limit_of_tilt(iterations: int) -> None:
    assert tilt_deg(TRUE[0]) > 5.7
    assert tilt_deg(refined(iterations=iterations, tilted=0.3).rotations) > 4.0
    assert tilt_deg(refined(3.0, iterations, tilted=0.3).rotations) <= 3.0


def test_a_limit_that_is_not_reached_changes_nothing() -> None:
    free, held = refined(), refined(15.0)
    torch.testing.assert_close(held.rotations, free.rotations)
    torch.testing.assert_close(held.positions, free.positions)
    assert float((held.positions - TRUE[1]).norm(dim=-1).max()) < 0.01


def test_a_position_solves_the_equations_of_a_step_with_the_turn_that_is_left() -> None:
    turn = torch.tensor([[0.03, -0.02, 0.01]])
    left, first = TRUE[0] @ rotation_from_vector(turn), TRUE[1][None] + torch.tensor([[0.03, 0.02, -0.02]])
    held = refine(LEVEL, SEEN, TRUE[0], first, 1, STEP, within=lambda _: left)
    seen = patch_equations(LEVEL, SEEN, TRUE[0], first, STEP)
    right = seen.gradient[0, 3:] + seen.hessian[0, 3:6, :3] @ turn[0]
    move = -torch.linalg.solve(seen.hessian[0, 3:6, 3:6], right)
    assert float(move.norm()) < STEP.max_step_m
    torch.testing.assert_close(held.positions[0], first[0] + TRUE[0][0] @ move, atol=1e-4, rtol=0)


def test_the_rest_of_the_pose_follows_a_tilt_that_is_held() -> None:
    def loss(rotation: torch.Tensor, position: torch.Tensor) -> float:
        return float(patch_equations(LEVEL, SEEN, rotation[None], position[None], STEP).loss[0])

    free, held = refined(), refined(3.0)
    turned_back = within(3.0).nearest_rotations(free.rotations)
    for number in range(2):
        assert tilt_deg(held.rotations[number, None]) == pytest.approx(3.0, abs=0.05)
        assert loss(held.rotations[number], held.positions[number]) < 0.4 * loss(
            turned_back[number], free.positions[number]
        )
