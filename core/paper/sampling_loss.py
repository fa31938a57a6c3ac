"""The paper's sampling loss and its minimisation by Adam. Paper: §3.3, Eq. 5."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import PaperConfig
from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.geometry.projection import project, sample_bilinear
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.paper.score_maps import sample_patch_map

_LEAST = 1e-12
_NOTHING_IN_VIEW = 2.0  # weights are at most one, and colours differ by no more than the root of three


@dataclass(frozen=True)
class SamplingProblem:
    """What the loss compares.

    image: (3, H, W) in 0..1 and valid: (H, W) 0 or 1. positions: (N, 3) metres; colors: (N, 3) in 0..1.
    point_weights: M_3D (N,). patch_scores: M_2D (P,) on `grid`.
    """

    image: Tensor
    valid: Tensor
    positions: Tensor
    colors: Tensor
    point_weights: Tensor
    patch_scores: Tensor
    grid: PatchGrid


def sampling_loss(problem: SamplingProblem, rotation: Tensor, position: Tensor) -> Tensor:
    """Return ‖½ (M_3D + S_2D) ⊙ [Γ(Π(R X + t)) − C]‖, divided by the square root of the number of points in view.

    rotation: (3, 3) map_from_camera; position: (3,). Differentiable in both. Deviation: the division makes losses comparable when a mask
    leaves different numbers of points. Where none is in view, as a photo may drift off the scan, the loss is larger than any other.
    """
    in_camera = (problem.positions - position) @ rotation
    height, width = problem.image.shape[1:]
    u, v = project(in_camera, height, width)
    sampled = sample_bilinear(problem.image, u, v)
    in_view = (sample_bilinear(problem.valid[None], u.detach(), v.detach())[..., 0] > 0.99).to(sampled.dtype)
    patch = sample_patch_map(problem.patch_scores, problem.grid, in_camera.detach())
    weights = 0.5 * (problem.point_weights + patch) * in_view
    residual = (sampled - problem.colors) * weights[:, None]
    count = in_view.sum()
    # The root of nothing has no slope; floored, its slope is zero.
    loss = residual.square().sum().clamp_min(_LEAST).sqrt() / count.clamp_min(1).sqrt()
    return torch.where(count > 0, loss, _NOTHING_IN_VIEW)


def minimize_by_adam(
    problem: SamplingProblem,
    rotation: Tensor,
    position: Tensor,
    config: PaperConfig,
    check: Callable[[], None] = lambda: None,
) -> tuple[Tensor, Tensor, float]:
    """Descend from one pose; return the rotation, position and loss of the best iterate.

    The learning rate falls when the loss has not improved for some iterations, as in the reference implementation.
    check: called before every iteration; what it raises passes through.
    """
    turn = torch.zeros(3, device=rotation.device, requires_grad=True)
    move = torch.zeros(3, device=rotation.device, requires_grad=True)
    optimizer = torch.optim.Adam([turn, move], lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimizer, factor=config.learning_rate_decay, patience=config.patience
    )
    best = (rotation, position, float("inf"))
    for _ in range(config.iterations):
        check()
        optimizer.zero_grad()
        turned, moved = rotation @ rotation_from_vector(turn), position + move
        loss = sampling_loss(problem, turned, moved)
        if loss.item() < best[2]:
            best = (turned.detach().clone(), moved.detach().clone(), loss.item())
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step(loss.item())
    return best
