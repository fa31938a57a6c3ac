"""Refinement on an image painted by a formula, whose pose is known."""

from dataclasses import replace

import pytest
import torch

from panoloc.core.config import StepConfig
from panoloc.core.geometry.rotations import even_directions, rotation_angle, rotation_from_vector, uniform_rotations
from panoloc.core.image.image_level import prepare_level
from panoloc.core.refine.gauss_newton import StepHistory, next_relaxation
from panoloc.core.refine.refinement import CandidatePoints, refine
from tests.core.refine.painted_scene import at_distances, painted, painted_sphere

HEIGHT = 128
ROTATION, POSITION = uniform_rotations(11)[4], torch.tensor([0.5, -1.0, 1.2])
IMAGE, DIRECTIONS = painted_sphere(HEIGHT), even_directions(3000)
# What the image shows, without errors of parallax.
POINTS = CandidatePoints(
    (POSITION + at_distances(DIRECTIONS) @ ROTATION.T)[None], painted(DIRECTIONS)[None], torch.ones((1, 3000))
)
EVERYWHERE = torch.ones((HEIGHT, 2 * HEIGHT))
BESIDE = POSITION + torch.tensor([0.15, -0.15, 0.1])


def assert_refined(
    metres: float,
    degrees: float,
    image: torch.Tensor = IMAGE,
    points: CandidatePoints = POINTS,
    valid: torch.Tensor = EVERYWHERE,
) -> None:
    """Check how far off the pose is after refinement from one that is 0.25 m and 9 degrees off."""
    start = ROTATION @ rotation_from_vector(torch.tensor([0.1, -0.1, 0.07]))
    found = refine(prepare_level(image, valid), points, start[None], BESIDE[None], 25, StepConfig())
    assert float((found.positions[0] - POSITION).norm()) < metres
    assert float(torch.rad2deg(rotation_angle(found.rotations[0].double(), ROTATION.double()))) < degrees


def test_refinement_does_not_mind_gain_and_offset() -> None:
    assert_refined(0.005, 0.1, IMAGE * torch.tensor([0.6, 1.3, 0.9])[:, None, None] + 0.05)


def test_refinement_does_not_mind_that_a_third_of_the_points_changed() -> None:
    changed = POINTS.colors.clone()
    changed[:, ::3] = torch.rand((1000, 3), generator=torch.Generator().manual_seed(3))
    assert_refined(0.02, 0.4, points=replace(POINTS, colors=changed))


def test_refinement_ignores_what_is_masked() -> None:
    valid = EVERYWHERE.clone()
    valid[40:100, 30:160] = 0
    assert_refined(0.01, 0.2, torch.where(valid.bool(), IMAGE, torch.ones(())), valid=valid)


def test_a_candidate_without_a_point_stays_where_it_is() -> None:
    nothing = replace(POINTS, weights=torch.zeros((1, 3000)))
    found = refine(prepare_level(IMAGE, EVERYWHERE), nothing, ROTATION[None], POSITION[None], 3, StepConfig())
    torch.testing.assert_close(found.positions[0], POSITION)
    assert bool(torch.isfinite(found.rotations).all())
    assert bool(torch.isfinite(found.loss).all())


@pytest.mark.parametrize(
    ("slope_before", "slope_after", "length"),
    [
        (-1.0, -0.5, 3.0),  # half way: twice as long
        (-1.0, -0.9, 3.0),  # hardly begun: no more than twice at once
        (-1.0, 0.0, 1.5),  # there
        (-1.0, 0.5, 1.0),  # beyond: two thirds of it
        (-1.0, -1.2, 3.0),  # it became steeper
        (0.0, 0.0, 1.5),  # the first step
    ],
)
def test_steps_are_lengthened_by_what_the_last_one_fell_short(
    slope_before: float, slope_after: float, length: float
) -> None:
    config = StepConfig(relaxation=1.5, max_relaxation=5.0)
    step = torch.tensor([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    history = StepHistory(step, torch.tensor([slope_before]), torch.tensor([1.5]))
    found = next_relaxation(history, step * slope_after, config)
    assert found.tolist() == pytest.approx([length])


def test_steps_that_learn_reach_the_pose_where_noise_makes_plain_ones_creep() -> None:
    noisy = IMAGE + 0.02 * torch.randn(IMAGE.shape, generator=torch.Generator().manual_seed(5))
    level = prepare_level(noisy, EVERYWHERE)
    errors = [
        float((refine(level, POINTS, ROTATION[None], BESIDE[None], 6, config).positions[0] - POSITION).norm())
        for config in (StepConfig(), StepConfig(max_relaxation=1.5))
    ]
    assert errors[0] < 0.005
    assert errors[0] < 0.3 * errors[1]
