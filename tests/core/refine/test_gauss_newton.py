"""One step of refinement: robust weights, how far it may go, how it is lengthened, and what light is fitted with."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.config import StepConfig
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector, uniform_rotations
from panoloc.core.image.image_level import ImageLevel, prepare_level
from panoloc.core.refine.gauss_newton import (
    PointPlanes,
    PoseStep,
    gauss_newton_step,
    initial_history,
    normal_equations,
)
from panoloc.core.refine.point_sampling import sample_points
from tests.core.refine.painted_scene import at_distances, painted, painted_sphere

HEIGHT = 64
RULES = StepConfig()
ROTATION = uniform_rotations(9)[5]
POSITION = torch.tensor([0.4, -0.2, 1.1])


def scene(count: int = 401) -> tuple[ImageLevel, PointPlanes]:
    """Return a painted sphere as seen from ROTATION and POSITION, and points that it shows, in their own colours."""
    image, directions = painted_sphere(HEIGHT), even_directions(count)
    place = POSITION + at_distances(directions) @ ROTATION.T
    points = PointPlanes(place.T[None].contiguous(), painted(directions).T[None].contiguous(), torch.ones((1, count)))
    return prepare_level(image, torch.ones(image.shape[1:])), points


def plain(count: int = 401, color: float = 0.5) -> tuple[ImageLevel, PointPlanes]:
    """Return the same points before an image of one colour, which they have as well."""
    _, points = scene(count)
    image = torch.full((3, HEIGHT, 2 * HEIGHT), color)
    return prepare_level(image, torch.ones(image.shape[1:])), replace(points, colors=torch.full((1, 3, count), color))


def step_from(
    level: ImageLevel,
    points: PointPlanes,
    rules: StepConfig = RULES,
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
    move: tuple[float, float, float] = (0.0, 0.0, 0.0),
    light_weights: torch.Tensor | None = None,
    relaxed: bool = False,
) -> PoseStep:
    """Take the first step from a pose beside the true one."""
    rotations = (ROTATION @ rotation_from_vector(torch.tensor(turn)))[None]
    positions = (POSITION + torch.tensor(move))[None]
    weights = points.weights if light_weights is None else light_weights
    history = initial_history(1, rules, torch.device("cpu"))
    return gauss_newton_step(level, points, rotations, positions, weights, history, rules, relaxed)


# Robust weights.


def test_residuals_lose_their_weight_by_the_square_of_what_they_are_to_the_scale() -> None:
    level, points = plain()
    residual = 0.3 * torch.rand((1, 1, 401), generator=torch.Generator().manual_seed(2)).expand(1, 3, -1)
    step = step_from(level, replace(points, colors=points.colors + residual), replace(RULES, fit_light=False))
    size = np.sqrt(3) * residual[0, 0].double().numpy()
    scale = 2.5 * np.median(size)
    assert float(step.scale) == pytest.approx(scale, rel=1e-5)
    np.testing.assert_allclose(step.weights[0].numpy(), (1 + (size / scale) ** 2) ** -2, rtol=1e-4)
    assert float(step.loss) == pytest.approx(np.mean(size**2 / (size**2 + scale**2)), rel=1e-4)
    faint = replace(points, colors=points.colors + residual, weights=points.weights * 1e-4)
    assert float(step_from(level, faint, replace(RULES, fit_light=False)).loss) == pytest.approx(float(step.loss))


def test_where_all_fits_the_scale_stays_above_what_is_noise() -> None:
    level, points = plain()
    step = step_from(level, points, replace(RULES, fit_light=False, min_residual=0.07))
    assert float(step.scale) == pytest.approx(0.07)
    assert float(step.loss) == pytest.approx(0, abs=1e-9)


def test_points_that_do_not_count_and_those_on_a_mask_have_no_part_in_scale_and_loss() -> None:
    level, points = plain()
    residual = torch.full((1, 3, 401), 0.1)
    weights = points.weights.clone()
    absent, masked = torch.arange(401) % 5 < 2, torch.zeros(401, dtype=torch.bool)
    weights[:, absent] = 0
    valid = torch.ones((HEIGHT, 2 * HEIGHT))
    valid[:24] = 0
    level = prepare_level(torch.full((3, HEIGHT, 2 * HEIGHT), 0.5), valid)
    _, inside = sample_points(level, points.positions, ROTATION[None], POSITION[None])
    masked |= ~inside[0]
    assert 50 < int(masked.sum()) < 250
    residual[:, :, absent | masked] = 0.45
    spoilt = replace(points, colors=points.colors + residual, weights=weights)
    step = step_from(level, spoilt, replace(RULES, fit_light=False))
    scale = 2.5 * 0.1 * 3**0.5
    assert float(step.scale) == pytest.approx(scale, rel=1e-4)
    assert float(step.loss) == pytest.approx(1 / (1 + 2.5**2), rel=1e-4)
    assert torch.equal(step.weights[0] > 0, ~(absent | masked))


def test_light_is_fitted_to_the_points_that_agreed_in_the_step_before() -> None:
    level, points = scene()
    target, trusted = points.colors * 0.7 + 0.1, torch.ones((1, 401))
    changed = torch.arange(401) % 3 == 0
    target[:, :, changed] = torch.rand((1, 3, int(changed.sum())), generator=torch.Generator().manual_seed(3))
    trusted[:, changed] = 0
    relit = replace(points, colors=target)
    knowing, ignorant = step_from(level, relit, light_weights=trusted), step_from(level, relit)
    # Residuals of unchanged points, in units of the scale.
    knowing_ratio, ignorant_ratio = (float(step.ratio[0, ~changed].mean()) for step in (knowing, ignorant))
    assert knowing_ratio < 0.05
    assert ignorant_ratio > 2 * knowing_ratio


# The step itself.


def test_a_step_solves_the_damped_equations_and_moves_in_the_cameras_frame() -> None:
    level, points = scene()
    turn, move = (0.02, -0.03, 0.01), (0.03, 0.02, -0.04)
    step = step_from(level, points, replace(RULES, fit_light=False, damping=0.1), turn, move)
    rotations = (ROTATION @ rotation_from_vector(torch.tensor(turn)))[None]
    positions = (POSITION + torch.tensor(move))[None]
    seen, _ = sample_points(level, points.positions, rotations, positions)
    hessian, gradient = normal_equations(seen, seen.color - points.colors, step.weights, False)
    damped = hessian[0].double() + torch.diag(0.1 * hessian[0].diagonal() + 1e-6)
    expected = -torch.linalg.solve(damped, gradient[0].double())
    torch.testing.assert_close(step.history.step[0].double(), expected, rtol=1e-3, atol=1e-5)
    torch.testing.assert_close(step.hessian, hessian)
    assert float(step.history.slope) == pytest.approx(float(gradient[0].double() @ expected), rel=1e-3)
    assert float(step.history.slope) < 0
    torch.testing.assert_close(step.rotations[0], rotations[0] @ rotation_from_vector(step.history.step[0, :3]))
    torch.testing.assert_close(step.positions[0], positions[0] + rotations[0] @ step.history.step[0, 3:])


def test_no_step_goes_further_than_the_rules_allow() -> None:
    level, points = scene()
    turn, move = (0.1, -0.2, 0.1), (0.3, 0.2, -0.2)
    free = step_from(level, points, replace(RULES, max_turn_rad=9.0, max_move_m=9.0), turn, move).history.step[0]
    bound = step_from(level, points, replace(RULES, max_turn_rad=0.02, max_move_m=0.01), turn, move).history.step[0]
    for part, limit in ((slice(0, 3), 0.02), (slice(3, 6), 0.01)):
        assert float(free[part].norm()) > 2 * limit
        torch.testing.assert_close(bound[part], free[part] * limit / free[part].norm())
    wide = step_from(level, points, replace(RULES, max_turn_rad=8.0, max_move_m=8.0), turn, move).history.step[0]
    torch.testing.assert_close(wide, free)
