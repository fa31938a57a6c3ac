"""The sampling loss, its gradient, and the Jacobian of the second-order refinement against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.config import PaperConfig
from panoloc.core.describe.spherical_patches import PatchGrid
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.geometry.rotations import rotation_from_vector, uniform_rotations
from panoloc.core.panorama.image_level import prepare_level
from panoloc.core.paper.sampling_loss import SamplingProblem, minimize_by_adam, sampling_loss
from panoloc.core.refine import gauss_newton, point_sampling
from tests.reference import loss_twin
from tests.reference.spherical_twin import direction_of

ROTATION = uniform_rotations(7)[3].double().numpy()
ROTATION = np.linalg.svd(ROTATION)[0] @ np.linalg.svd(ROTATION)[2]
POSITION = np.array([0.2, -0.3, 0.1])


def painted(directions: np.ndarray) -> np.ndarray:
    """Return smooth colours (..., 3) on the sphere."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    red, green, blue = 0.5 + 0.3 * x * y + 0.1 * z, 0.5 + 0.3 * y * z - 0.1 * x, 0.5 + 0.2 * (x * x - z * z) + 0.1 * y
    return np.stack((red, green, blue), axis=-1)


@pytest.fixture(scope="module")
def problem() -> tuple[SamplingProblem, np.ndarray]:
    rng = np.random.default_rng(0)
    image = rng.uniform(size=(12, 24, 3))
    points = rng.normal(size=(60, 3))
    points *= rng.uniform(1.5, 4, (60, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    made = SamplingProblem(
        torch.from_numpy(image).permute(2, 0, 1).contiguous(),
        torch.ones((12, 24), dtype=torch.float64),
        torch.from_numpy(points),
        torch.from_numpy(rng.uniform(size=(60, 3))),
        torch.from_numpy(rng.uniform(size=60)),
        torch.from_numpy(rng.uniform(size=18)),
        PatchGrid(3, 6),
    )
    return made, image


def twin_loss(problem: SamplingProblem, image: np.ndarray, step: np.ndarray) -> float:
    return loss_twin.sampling_loss(
        image,
        problem.positions.numpy(),
        problem.colors.numpy(),
        problem.point_weights.numpy(),
        problem.patch_scores.numpy(),
        problem.grid.rows,
        problem.grid.columns,
        loss_twin.turned(ROTATION, step[:3]),
        POSITION + step[3:],
    )


def test_the_sampling_loss_agrees_with_a_loop_over_points(problem: tuple[SamplingProblem, np.ndarray]) -> None:
    made, image = problem
    found = sampling_loss(made, torch.from_numpy(ROTATION), torch.from_numpy(POSITION))
    assert abs(float(found) - twin_loss(made, image, np.zeros(6))) < 1e-9


def test_where_nothing_is_in_view_the_loss_is_larger_than_any_other_and_flat(
    problem: tuple[SamplingProblem, np.ndarray],
) -> None:
    blind = replace(problem[0], valid=torch.zeros_like(problem[0].valid))
    move = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    loss = sampling_loss(blind, torch.from_numpy(ROTATION), torch.from_numpy(POSITION) + move)
    loss.backward()  # type: ignore[no-untyped-call]
    assert float(loss.detach()) > 3**0.5
    assert move.grad is not None
    assert move.grad.tolist() == [0, 0, 0]
    named = ("image", "valid", "positions", "colors", "point_weights", "patch_scores")
    single = replace(blind, **{name: getattr(blind, name).float() for name in named})
    found = minimize_by_adam(single, torch.eye(3), torch.zeros(3), replace(PaperConfig(), iterations=3))
    assert all(torch.isfinite(each).all() for each in found[:2])


def test_the_gradient_of_the_sampling_loss_agrees_with_finite_differences(
    problem: tuple[SamplingProblem, np.ndarray],
) -> None:
    made, image = problem
    step = torch.zeros(6, dtype=torch.float64)
    step[0] = 1e-7  # the derivative of the exponential map at exactly zero angle is a limit
    step.requires_grad_()
    turned = torch.from_numpy(ROTATION) @ rotation_from_vector(step[:3])
    sampling_loss(made, turned, torch.from_numpy(POSITION) + step[3:]).backward()  # type: ignore[no-untyped-call]
    assert step.grad is not None
    expected = np.zeros(6)
    for axis in range(6):
        ahead, behind = np.zeros(6), np.zeros(6)
        ahead[axis], behind[axis] = 1e-6, -1e-6
        expected[axis] = (twin_loss(made, image, ahead) - twin_loss(made, image, behind)) / 2e-6
    np.testing.assert_allclose(step.grad.numpy(), expected, rtol=1e-3, atol=1e-6)


def test_masked_points_have_no_part_in_the_sampling_loss(problem: tuple[SamplingProblem, np.ndarray]) -> None:
    made, _ = problem
    valid = torch.ones_like(made.valid)
    valid[3:9, 5:12] = 0
    image = made.image.clone()
    image[:, 3:9, 5:12] = 1.0
    pose = torch.from_numpy(ROTATION), torch.from_numpy(POSITION)
    plain, repainted = (
        float(sampling_loss(replace(made, image=each, valid=valid), *pose)) for each in (made.image, image)
    )
    # A sample counts when at least 99 % of it is unmasked.
    assert plain == pytest.approx(repainted, abs=2e-3)


HEIGHT = 128


def jacobian_of(seen: point_sampling.SampledPoints) -> np.ndarray:
    """Return the Jacobians (N, 3, 6) of the first candidate."""
    return np.asarray(np.einsum("can,kan->nck", seen.derivatives[0].numpy(), seen.directions[0].numpy()))


def linearized(positions: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return colours (N, 3) and Jacobians (N, 3, 6) of the code at the pose moved by `step` in the camera frame."""
    image = torch.from_numpy(painted(pixel_directions(HEIGHT, 2 * HEIGHT).numpy())).float().permute(2, 0, 1)
    level = prepare_level(image, torch.ones(image.shape[1:]))
    place = torch.from_numpy(positions).float().T[None]
    rotation = torch.from_numpy(loss_twin.turned(ROTATION, step[:3])).float()[None]
    position = torch.from_numpy(POSITION + ROTATION @ step[3:]).float()[None]
    seen, _ = point_sampling.sample_points(level, place, rotation, position)
    return seen.color[0].T.numpy(), jacobian_of(seen)


def test_the_jacobian_of_refinement_agrees_with_finite_differences_of_a_painted_sphere() -> None:
    rng = np.random.default_rng(1)
    in_camera = np.array([direction_of(u, v, 64, 128) for u, v in rng.uniform((0, 6), (128, 58), (80, 2))])
    positions = in_camera * rng.uniform(1, 4, (80, 1)) @ ROTATION.T + POSITION
    _, jacobian = linearized(positions, np.zeros(6))

    def color(step: np.ndarray) -> np.ndarray:
        turned = loss_twin.turned(ROTATION, step[:3])
        seen = (positions - POSITION - ROTATION @ step[3:]) @ turned
        return painted(seen / np.linalg.norm(seen, axis=1, keepdims=True))

    for axis in range(6):
        ahead = np.zeros(6)
        ahead[axis] = 1e-5
        expected = (color(ahead) - color(-ahead)) / 2e-5
        np.testing.assert_allclose(jacobian[:, :, axis], expected, atol=0.01)


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
    jacobian = jacobian_of(seen)
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
