"""Refinement of many candidates at once by damped Gauss-Newton on the robust sampling loss.

Each candidate has its own points; a step samples the panorama where the points project to, fits gain and offset per channel
(light differs between scan and photo), weighs residuals down that no pose explains (changed furniture), and solves 6 x 6 normal equations.

Paper: §3.3, Eq. 5 (sampling loss).
Deviation: the paper runs Adam on all points at full resolution for 100 steps. The Jacobian of the loss is known in closed form and
the problem has six unknowns, so second-order steps from coarse to fine need an order of magnitude fewer evaluations.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from core.projection import bilinear_corners, project, wrap_border
from core.rotations import rotation_from_vector

_MIN_COSINE = 0.05  # rows next to a pole: the azimuth derivative grows without bound there
_MIN_DISTANCE_M = 0.05


@dataclass(frozen=True)
class ImageLevel:
    """One level of the panorama's pyramid, prepared for sampling.

    packed: ((H + 2) (W + 2), 13) float32: colour (3), spatial gradient per channel (3 x 3: red x y z, green x y z, blue x y z; per
    radian, camera frame), validity (1); with the border of `wrap_border`.
    """

    packed: Tensor
    height: int
    width: int


def prepare_level(color: Tensor, valid: Tensor) -> ImageLevel:
    """Prepare an image (3, H, W) float32 with validity (H, W) float32 in 0..1 for sampling."""
    _, height, width = color.shape
    device = color.device
    padded = wrap_border(color)
    step = 2 * math.pi / width
    seen = wrap_border(valid[None])  # the gradient at the edge of a mask is unknown, not that towards a black pixel
    along_u = (padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]) / (2 * step) * (seen[:, 1:-1, 2:] * seen[:, 1:-1, :-2])
    along_v = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    along_v = along_v / (2 * math.pi / height) * (seen[:, 2:, 1:-1] * seen[:, :-2, 1:-1])
    azimuth = math.pi - (torch.arange(width, device=device) + 0.5) * step
    elevation = math.pi / 2 - (torch.arange(height, device=device) + 0.5) * (math.pi / height)
    cosine, sine = elevation.cos()[:, None], elevation.sin()[:, None]
    zero = torch.zeros((height, width), device=device)
    east = torch.stack((-azimuth.sin() + zero, azimuth.cos() + zero, zero))  # direction of growing azimuth
    north = torch.stack((-sine * azimuth.cos(), -sine * azimuth.sin(), cosine + zero))
    # u falls with azimuth, v falls with elevation.
    gradient = -along_u[:, None] / cosine.clamp_min(_MIN_COSINE) * east - along_v[:, None] * north
    stack = torch.cat((color, gradient.flatten(0, 1), valid[None]))
    return ImageLevel(wrap_border(stack).flatten(1).T.contiguous(), height, width)


@dataclass(frozen=True)
class CandidatePoints:
    """What each of K candidates aligns: positions (K, N, 3) metres, colors (K, N, 3), weights (K, N) >= 0 (zero: no point)."""

    positions: Tensor
    colors: Tensor
    weights: Tensor

    def take(self, keep: Tensor) -> "CandidatePoints":
        """Return the points of the candidates numbered `keep`."""
        return CandidatePoints(self.positions[keep], self.colors[keep], self.weights[keep])


@dataclass(frozen=True)
class RefinementSteps:
    """How one level is refined: how often, the light model, and the robust scale as a multiple of the median residual."""

    iterations: int
    fit_light: bool = True
    robust_scale: float = 1.5
    min_scale: float = 0.02
    max_turn: float = 0.2  # radians per step
    max_move: float = 0.3  # metres per step
    damping: float = 1e-3


@dataclass(frozen=True)
class Refined:
    """Poses after refinement.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3). Of the last step: loss (K,) in 0..1; hessian (K, 6, 6) of half the weighted
    squared residuals by turn and move; scale (K,), the residual at which a point counts a quarter; num_points (K,) that were in view.
    """

    rotations: Tensor
    positions: Tensor
    loss: Tensor
    hessian: Tensor
    scale: Tensor
    num_points: Tensor


def refine(
    level: ImageLevel, points: CandidatePoints, rotations: Tensor, positions: Tensor, steps: RefinementSteps
) -> Refined:
    """Refine K poses on one image level.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3) metres.
    """
    hessian = torch.zeros((len(rotations), 6, 6), device=rotations.device)
    loss = torch.zeros(len(rotations), device=rotations.device)
    scale, count = loss[:, None], loss
    weights = points.weights
    for _ in range(steps.iterations):
        residual, jacobian, base = _linearize(level, points, rotations, positions, weights, steps.fit_light)
        magnitude = residual.square().sum(-1).sqrt()
        scale = (steps.robust_scale * _weighted_median(magnitude, base)).clamp_min(steps.min_scale)[:, None]
        ratio = (magnitude / scale).square()
        weights = base / (1 + ratio).square()  # Geman-McClure: bounded influence
        loss = (base * ratio / (1 + ratio)).sum(-1) / base.sum(-1).clamp_min(1e-9)
        count = (base > 0).sum(-1)
        if steps.fit_light:
            jacobian = _without_light(jacobian, residual + points.colors, weights)
        weighted = jacobian * weights[..., None, None]
        hessian = torch.einsum("knci,kncj->kij", weighted, jacobian)
        gradient = torch.einsum("knci,knc->ki", weighted, residual)
        rotations, positions = _step(rotations, positions, hessian, gradient, steps)
    return Refined(rotations, positions, loss, hessian, scale[:, 0], count)


def _linearize(
    level: ImageLevel, points: CandidatePoints, rotations: Tensor, positions: Tensor, weights: Tensor, fit_light: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return residuals (K, N, 3), Jacobians (K, N, 3, 6) by turn and move in the camera frame, and base weights (K, N)."""
    in_camera = (points.positions - positions[:, None]) @ rotations
    distance = in_camera.norm(dim=-1, keepdim=True).clamp_min(_MIN_DISTANCE_M)
    direction = in_camera / distance
    u, v = project(in_camera, level.height, level.width)
    corners, shares = bilinear_corners(u, v, level.height, level.width)
    sampled = (level.packed[corners] * shares[..., None]).sum(-2)
    color, valid = sampled[..., :3], sampled[..., 12]
    gradient = sampled[..., 3:12].reshape(*sampled.shape[:-1], 3, 3)
    base = points.weights * (valid > 0.99)
    if fit_light:
        gain, offset = fit_gain_offset(color, points.colors, weights * (valid > 0.99))
        color = color * gain[:, None] + offset[:, None]
        gradient = gradient * gain[:, None, :, None]
    # A camera turn ω and move τ (camera frame) shift the point's direction by −ω × d and −τ / ρ.
    turn = -torch.linalg.cross(direction[..., None, :].expand_as(gradient), gradient, dim=-1)
    move = -gradient / distance[..., None]
    return color - points.colors, torch.cat((turn, move), dim=-1), base


def fit_gain_offset(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return gain and offset (K, 3) that bring `source` (K, N, 3) nearest to `target`, weighted (K, N); gains stay in 0.3..3.

    A small prior towards gain 1 keeps the fit defined where there is no contrast.
    """
    total = weights.sum(-1).clamp_min(1e-9)[:, None]
    share = (weights / total)[..., None]
    mean_source, mean_target = (share * source).sum(1), (share * target).sum(1)
    centered = source - mean_source[:, None]
    variance = (share * centered.square()).sum(1)
    covariance = (share * centered * (target - mean_target[:, None])).sum(1)
    prior = 1e-3
    gain = ((covariance + prior) / (variance + prior)).clamp(0.3, 3.0)
    return gain, mean_target - gain * mean_source


def _without_light(jacobian: Tensor, fitted: Tensor, weights: Tensor) -> Tensor:
    """Remove from the Jacobian (K, N, 3, 6) what a change of gain and offset would undo.

    fitted: (K, N, 3) colours after the fit. Gain and offset are solved for anew in every step; a step that takes them for constants
    crawls where light and pose pull against each other (variable projection, Golub and Pereyra 1973).
    """
    share = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-9))[..., None]
    centered = jacobian - (share[..., None] * jacobian).sum(1, keepdim=True)
    contrast = fitted - (share * fitted).sum(1, keepdim=True)
    variance = (share * contrast.square()).sum(1).clamp_min(1e-6)
    slope = ((share * contrast)[..., None] * centered).sum(1) / variance[..., None]
    return centered - contrast[..., None] * slope[:, None]


def _weighted_median(values: Tensor, weights: Tensor) -> Tensor:
    """Return the median (K,) of values (K, N) among those of positive weight."""
    masked = torch.where(weights > 0, values, torch.full_like(values, math.nan))
    return torch.nanmedian(masked, dim=-1).values.nan_to_num(1.0)


def _step(
    rotations: Tensor, positions: Tensor, hessian: Tensor, gradient: Tensor, steps: RefinementSteps
) -> tuple[Tensor, Tensor]:
    """Solve the damped normal equations and move the poses, no further than the limits of `steps`."""
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(diagonal * steps.damping + 1e-6)
    update = -torch.linalg.solve(damped, gradient)
    turn, move = update[:, :3], update[:, 3:]
    turn = turn * (steps.max_turn / turn.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    move = move * (steps.max_move / move.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    moved = positions + torch.einsum("kab,kb->ka", rotations, move)
    return rotations @ rotation_from_vector(turn), moved
