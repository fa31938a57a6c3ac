"""The sampling loss against a loop over points, and the equations of refinement against line fits in patches."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.config import CONTRAST, PaperConfig, StepConfig
from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.image.level import SampledPoints
from panoloc.core.paper.sampling_loss import SamplingProblem, minimize_by_adam, sampling_loss
from panoloc.core.refine.patches import PatchSums
from panoloc.core.refine.step import PointPlanes, patch_equations
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


def looped_equations(
    seen: SampledPoints, colors: np.ndarray, weights: np.ndarray, patches: np.ndarray, floor: float
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return Hessian (U, U), gradient (U,), loss and scale of one candidate, patch by patch.

    colors: (3, N); weights: (N,), zero outside of the images; patches: (N,). Light is what the best gain and offsets of a patch undo.
    """
    jacobian = np.einsum("can,kan->nck", seen.derivatives[0].numpy(), seen.directions[0].numpy())
    hessian, gradient = np.zeros((jacobian.shape[2],) * 2), np.zeros(jacobian.shape[2])
    loss = squares = 0.0
    for patch in range(patches.max() + 1):
        here = patches == patch
        mass = weights[here].sum()
        share = weights[here] / mass
        shown, scanned = (each.T[here] - share @ each.T[here] for each in (seen.color[0].numpy(), colors))
        covariance, variance, wanted = (
            float(share @ (one * other).sum(1)) for one, other in ((shown, scanned), (shown, shown), (scanned, scanned))
        )
        correlation = np.clip(covariance / math.sqrt((variance + floor) * (wanted + floor)), 0, 0.999)
        unexplained, gain = math.sqrt(1 - correlation**2), max(0.0, covariance / (variance + floor))
        loss += mass * unexplained / weights.sum()
        if mass <= 8:
            continue
        votes = np.repeat(weights[here] / (unexplained * (wanted + floor)), 3)
        residual, root = (gain * shown - scanned).ravel(), np.sqrt(votes)[:, None]
        light = np.column_stack((shown.ravel(), np.tile(np.eye(3), (here.sum(), 1))))
        rows = gain * jacobian[here].reshape(3 * here.sum(), -1)
        rows = rows - light @ np.linalg.lstsq(root * light, root * rows, rcond=None)[0]
        hessian += (root * rows).T @ (root * rows)
        gradient += rows.T @ (votes * residual)
        squares += float(votes @ residual**2)
    return hessian, gradient, loss, math.sqrt(squares / weights.sum())


@pytest.mark.parametrize("unknowns", [6, 7])
def test_the_equations_of_a_step_are_those_of_the_jacobian_without_the_light_of_each_patch(unknowns: int) -> None:
    rng = np.random.default_rng(2)
    patches = np.repeat(np.arange(4), (30, 40, 5, 45))  # one with too few points for a vote
    count = len(patches)
    planes, directions = rng.normal(size=(1, 9, count)), rng.normal(size=(1, unknowns, 2, count))
    colors = 0.6 * planes[0, :3] + np.array([0.5, 0.1, 0.0, -0.4])[patches] + 0.5 * rng.normal(size=(3, count))
    colors[:, patches == 1] *= -1  # a patch that disagrees
    weights, inside = rng.uniform(0.5, 1.5, count), rng.uniform(size=count) < 0.9
    seen = SampledPoints(torch.from_numpy(planes), torch.from_numpy(directions))
    level: Any = SimpleNamespace(sample_points=lambda *_: (seen, torch.from_numpy(inside)[None]))
    place, painted, counted = (torch.from_numpy(each)[None] for each in (np.zeros((3, count)), colors, weights))
    points = PointPlanes(place, painted, counted, None, PatchSums(torch.from_numpy(patches)))
    config = StepConfig(robust_scale=None)
    focals = torch.zeros(1) if unknowns == 7 else None
    found = patch_equations(level, points, POSE[0][None], POSE[1][None], config, focals, unknowns == 7)
    expected = looped_equations(seen, colors, weights * inside, patches, CONTRAST.noise)
    assert abs(expected[1]).max() > 0.1
    for value, wanted in zip((found.hessian, found.gradient, found.loss, found.scale), expected, strict=True):
        np.testing.assert_allclose(value[0].numpy(), np.asarray(wanted), rtol=1e-6, atol=1e-9)
