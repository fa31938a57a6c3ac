"""The sampling loss against a loop over points, and the normal equations of refinement against a line fit."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.config import PaperConfig
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.image.image_level import prepare_level
from panoloc.core.paper.sampling_loss import SamplingProblem, minimize_by_adam, sampling_loss
from panoloc.core.refine import gauss_newton, point_sampling
from tests.core.found_pose import known
from tests.core.painted_box import rotation_of
from tests.reference.spherical_twin import image_position_of, patch_of, sample

ROTATION = rotation_of(50.0, -30.0, 20.0)
POSITION = np.array([0.2, -0.3, 0.1])
POSE = torch.from_numpy(ROTATION), torch.from_numpy(POSITION)


def looped_loss(
    image: np.ndarray,
    points: np.ndarray,
    colors: np.ndarray,
    point_weights: np.ndarray,
    patch_scores: np.ndarray,
    rows: int,
    columns: int,
    rotation: np.ndarray,
    position: np.ndarray,
) -> float:
    """Return ‖½ (M_3D + S_2D) ⊙ [Γ(Π(x_camera); I) − C]‖ / √N; x_camera = rotationᵀ (x_map − position); image (H, W, 3)."""
    total = 0.0
    height, width = image.shape[:2]
    for point, color, point_weight in zip(points, colors, point_weights, strict=True):
        in_camera = rotation.T @ (point - position)
        u, v = image_position_of(in_camera, height, width)
        weight = 0.5 * (point_weight + patch_scores[patch_of(in_camera, rows, columns)])
        total += float((weight * (sample(image, u, v) - color)) @ (weight * (sample(image, u, v) - color)))
    return math.sqrt(total) / math.sqrt(len(points))


def made_problem() -> SamplingProblem:
    rng = np.random.default_rng(0)
    image, colors = rng.uniform(size=(12, 24, 3)), rng.uniform(size=(60, 3))
    colors[:5] = 0.0  # black points count like any other
    points = rng.normal(size=(60, 3))
    points *= rng.uniform(1.5, 4, (60, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    positions, painted, weights, scores = (
        torch.from_numpy(each) for each in (points, colors, rng.uniform(size=60), rng.uniform(size=18))
    )
    planes, valid = torch.from_numpy(image).permute(2, 0, 1).contiguous(), torch.ones((12, 24), dtype=torch.float64)
    return SamplingProblem(planes, valid, positions, painted, weights, scores, PatchGrid(3, 6))


PROBLEM = made_problem()


def test_the_sampling_loss_agrees_with_a_loop_over_points() -> None:
    given = (PROBLEM.positions, PROBLEM.colors, PROBLEM.point_weights, PROBLEM.patch_scores)
    points, colors, weights, scores = (each.numpy() for each in given)
    image = PROBLEM.image.permute(1, 2, 0).numpy()
    expected = looped_loss(image, points, colors, weights, scores, 3, 6, ROTATION, POSITION)
    assert float(sampling_loss(PROBLEM, *POSE)) == pytest.approx(expected, abs=1e-9)


def test_where_nothing_is_in_view_the_loss_is_larger_than_any_other_and_flat() -> None:
    blind = replace(PROBLEM, valid=torch.zeros_like(PROBLEM.valid))
    move = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    loss = sampling_loss(blind, POSE[0], POSE[1] + move)
    loss.backward()  # type: ignore[no-untyped-call]
    assert float(loss.detach()) > 3**0.5
    assert known(move.grad).tolist() == [0, 0, 0]
    named = ("image", "valid", "positions", "colors", "point_weights", "patch_scores")
    single = replace(blind, **{name: getattr(blind, name).float() for name in named})
    found = minimize_by_adam(single, torch.eye(3), torch.zeros(3), replace(PaperConfig(), iterations=3))
    assert all(torch.isfinite(each).all() for each in found[:2])


def test_masked_points_have_no_part_in_the_sampling_loss() -> None:
    valid, repainted = torch.ones_like(PROBLEM.valid), PROBLEM.image.clone()
    valid[3:9, 5:12] = 0
    repainted[:, 3:9, 5:12] = 1.0
    losses = [
        float(sampling_loss(replace(PROBLEM, image=image, valid=valid), *POSE)) for image in (PROBLEM.image, repainted)
    ]
    # A sample counts when at least 99 % of it is unmasked.
    assert losses[0] == pytest.approx(losses[1], abs=2e-3)


@pytest.mark.parametrize("fit_light", [True, False])
def test_the_normal_equations_are_those_of_the_jacobian_without_light(fit_light: bool) -> None:
    rng = np.random.default_rng(2)
    count = 60
    planes = torch.from_numpy(rng.normal(size=(1, 9, count)))
    seen = point_sampling.SampledPoints(planes, torch.from_numpy(rng.normal(size=(1, 6, 2, count))))
    residual, weights = rng.normal(size=(1, 3, count)), rng.uniform(size=(1, count))
    hessian, gradient = gauss_newton.normal_equations(
        seen, torch.from_numpy(residual), torch.from_numpy(weights), fit_light
    )
    jacobian = np.einsum("can,kan->nck", seen.derivatives[0].numpy(), seen.directions[0].numpy())
    expected_hessian, expected_gradient = np.zeros((6, 6)), np.zeros(6)
    for channel in range(3):
        rows, root = jacobian[:, channel], np.sqrt(weights[0])[:, None]
        if fit_light:  # what the best gain and offset leave of every column
            light = np.column_stack((planes[0, channel].numpy(), np.ones(count)))
            rows = rows - light @ np.linalg.lstsq(root * light, root * rows, rcond=None)[0]
        expected_hessian += (root * rows).T @ (root * rows)
        expected_gradient += rows.T @ (weights[0] * residual[0, channel])
    np.testing.assert_allclose(hessian[0].numpy(), expected_hessian, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(gradient[0].numpy(), expected_gradient, rtol=1e-6, atol=1e-9)


def test_the_image_gradient_next_to_a_mask_does_not_see_what_is_under_it() -> None:
    image = torch.rand((3, 16, 32), generator=torch.Generator().manual_seed(1))
    valid = torch.ones((16, 32))
    valid[5:9, 10:15] = 0
    repainted = torch.where(valid.bool(), image, torch.zeros(()))
    one, other = prepare_level(image, valid), prepare_level(repainted, valid)
    inside = one.planes[9] > 0.99
    torch.testing.assert_close(one.planes[:, inside], other.planes[:, inside])
