"""Refinement on an image painted by a formula, whose pose is known."""

import pytest
import torch

from panoloc.core.config import StepConfig
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector, uniform_rotations
from panoloc.core.panorama.image_level import prepare_level
from panoloc.core.refine.gauss_newton import StepHistory, next_relaxation
from panoloc.core.refine.refinement import CandidatePoints, refine

HEIGHT = 128


def painted(directions: torch.Tensor) -> torch.Tensor:
    x, y, z = directions.unbind(-1)
    red, green = 0.5 + 0.3 * (3 * x + 2 * y).sin(), 0.5 + 0.3 * (4 * y - z).sin()
    return torch.stack((red, green, 0.5 + 0.3 * (3 * z + x).cos()), dim=-1)


@pytest.fixture(scope="module")
def scene() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return an image (3, H, W), points (N, 3) that it shows without parallax errors, their colours, and the rotation."""
    rotation = uniform_rotations(11)[4]
    directions = torch.nn.functional.normalize(
        torch.randn((3000, 3), generator=torch.Generator().manual_seed(0)), dim=-1
    )
    distance = 1 + 3 * torch.rand((3000, 1), generator=torch.Generator().manual_seed(1))
    position = torch.tensor([0.5, -1.0, 1.2])
    points = position + distance * directions @ rotation.T
    image = painted(pixel_directions(HEIGHT, 2 * HEIGHT)).permute(2, 0, 1).contiguous()
    return image, points, painted(directions), rotation


POSITION = torch.tensor([0.5, -1.0, 1.2])


def refined_errors(
    image: torch.Tensor,
    points: torch.Tensor,
    colors: torch.Tensor,
    rotation: torch.Tensor,
    valid: torch.Tensor | None = None,
) -> tuple[float, float]:
    """Return metres and degrees off after refinement from a pose that is 0.25 m and 9 degrees off."""
    level = prepare_level(image, torch.ones(image.shape[1:]) if valid is None else valid)
    candidates = CandidatePoints(points[None], colors[None], torch.ones((1, len(points))))
    start = rotation @ rotation_from_vector(torch.tensor([0.1, -0.1, 0.07]))
    found = refine(
        level, candidates, start[None], (POSITION + torch.tensor([0.15, -0.15, 0.1]))[None], 25, StepConfig()
    )
    angle = float(torch.rad2deg(rotation_angle(found.rotations[0].double(), rotation.double())))
    return float((found.positions[0] - POSITION).norm()), angle


def test_refinement_does_not_mind_gain_and_offset(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    metres, degrees = refined_errors(
        image * torch.tensor([0.6, 1.3, 0.9])[:, None, None] + 0.05, points, colors, rotation
    )
    assert metres < 0.005
    assert degrees < 0.1


def test_refinement_does_not_mind_that_a_third_of_the_points_changed(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    changed = colors.clone()
    changed[::3] = torch.rand((1000, 3), generator=torch.Generator().manual_seed(3))
    metres, degrees = refined_errors(image, points, changed, rotation)
    assert metres < 0.02
    assert degrees < 0.4


def test_refinement_ignores_what_is_masked(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    valid = torch.ones((HEIGHT, 2 * HEIGHT))
    valid[40:100, 30:160] = 0
    spoilt = torch.where(valid.bool(), image, torch.ones(()))
    metres, degrees = refined_errors(spoilt, points, colors, rotation, valid)
    assert metres < 0.01
    assert degrees < 0.2


def test_a_candidate_without_a_point_stays_where_it_is(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    level = prepare_level(image, torch.ones(image.shape[1:]))
    nothing = CandidatePoints(points[None], colors[None], torch.zeros((1, len(points))))
    found = refine(level, nothing, rotation[None], POSITION[None], 3, StepConfig())
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


def test_steps_that_learn_reach_the_pose_where_noise_makes_plain_ones_creep(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    noisy = image + 0.02 * torch.randn(image.shape, generator=torch.Generator().manual_seed(5))
    level = prepare_level(noisy, torch.ones(image.shape[1:]))
    candidates = CandidatePoints(points[None], colors[None], torch.ones((1, len(points))))
    start = POSITION + torch.tensor([0.15, -0.15, 0.1])
    errors = [
        float((refine(level, candidates, rotation[None], start[None], 6, config).positions[0] - POSITION).norm())
        for config in (StepConfig(), StepConfig(max_relaxation=1.5))
    ]
    assert errors[0] < 0.005
    assert errors[0] < 0.3 * errors[1]
