"""Refinement of many candidates at once by damped Gauss-Newton on the robust sampling loss.

Each candidate has its own points; a step samples the panorama where the points project to, fits gain and offset per channel
(light differs between scan and photo), weighs residuals down that no pose explains (changed furniture), and solves 6 x 6 normal equations.

Paper: §3.3, Eq. 5 (sampling loss).
Deviation: the paper runs Adam on all points at full resolution for 100 steps. The Jacobian of the loss is known in closed form and
the problem has six unknowns, so second-order steps from coarse to fine need an order of magnitude fewer evaluations.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from core.projection import project, sample_planes, wrap_border
from core.rotations import rotation_from_vector

_MIN_COSINE = 0.05  # rows next to a pole: the azimuth derivative grows without bound there
_MIN_DISTANCE_M = 0.05
_VALID_SHARE = 0.99  # of the four pixels that a sample mixes


@dataclass(frozen=True)
class ImageLevel:
    """One level of the panorama's pyramid, prepared for sampling.

    planes: (10, H + 2, W + 2) float32: colour (3), its derivatives by azimuth (3) and by elevation (3) per radian, validity (1);
    with the border of `wrap_border`.
    """

    planes: Tensor
    height: int
    width: int


def prepare_level(color: Tensor, valid: Tensor) -> ImageLevel:
    """Prepare an image (3, H, W) float32 with validity (H, W) float32 in 0..1 for sampling."""
    _, height, width = color.shape
    padded = wrap_border(color)
    seen = wrap_border(valid[None])  # the gradient at the edge of a mask is unknown, not that towards a black pixel
    # Columns run against the azimuth, rows against the elevation.
    by_azimuth = (padded[:, 1:-1, :-2] - padded[:, 1:-1, 2:]) * (width / (4 * math.pi))
    by_azimuth = by_azimuth * (seen[:, 1:-1, 2:] * seen[:, 1:-1, :-2])
    by_elevation = (padded[:, :-2, 1:-1] - padded[:, 2:, 1:-1]) * (height / (2 * math.pi))
    by_elevation = by_elevation * (seen[:, 2:, 1:-1] * seen[:, :-2, 1:-1])
    return ImageLevel(wrap_border(torch.cat((color, by_azimuth, by_elevation, valid[None]))), height, width)


@dataclass(frozen=True)
class CandidatePoints:
    """What each of K candidates aligns: positions (K, N, 3) metres, colors (K, N, 3), weights (K, N) >= 0 (zero: no point)."""

    positions: Tensor
    colors: Tensor
    weights: Tensor

    def take(self, keep: Tensor) -> "CandidatePoints":
        """Return the points of the candidates numbered `keep`."""
        return CandidatePoints(self.positions[keep], self.colors[keep], self.weights[keep])


def joined(parts: Sequence[CandidatePoints]) -> CandidatePoints:
    """Return the points of several groups of candidates, one group after the other; all with the same number N."""
    return CandidatePoints(
        torch.cat([part.positions for part in parts]),
        torch.cat([part.colors for part in parts]),
        torch.cat([part.weights for part in parts]),
    )


@dataclass(frozen=True)
class RefinementSteps:
    """How one level is refined: how often, the light model, and the robust scale as a multiple of the median residual.

    relaxation: what steps are lengthened by. Weights lag behind the pose, so plain steps fall short and creep; the last one is plain.
    """

    iterations: int
    fit_light: bool = True
    robust_scale: float = 1.5
    min_scale: float = 0.02
    max_turn: float = 0.2  # radians per step
    max_move: float = 0.3  # metres per step
    damping: float = 1e-3
    relaxation: float = 1.5


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
    # One plane per coordinate and channel: processors and GPUs are several times faster on planes than on triples.
    place, target = points.positions.transpose(1, 2).contiguous(), points.colors.transpose(1, 2).contiguous()
    hessian = torch.zeros((len(rotations), 6, 6), device=rotations.device)
    loss = torch.zeros(len(rotations), device=rotations.device)
    scale, count = loss, loss
    weights = points.weights
    for iteration in range(steps.iterations):
        seen, inside = _see(level, place, rotations, positions)
        base = points.weights * inside
        if steps.fit_light:
            seen = seen.with_light(*_line_fit(seen.color, target, weights * inside))
        residual = seen.color - target
        squared = residual.square().sum(1)
        scale = (steps.robust_scale * _weighted_median(squared, base).sqrt()).clamp_min(steps.min_scale)
        ratio = squared / scale.square()[:, None]
        weights = base / (1 + ratio).square()  # Geman-McClure: bounded influence
        loss = (base * ratio / (1 + ratio)).sum(-1) / base.sum(-1).clamp_min(1e-9)
        count = (base > 0).sum(-1)
        hessian, gradient = _normal_equations(seen, residual, weights, steps.fit_light)
        length = steps.relaxation if iteration + 1 < steps.iterations else 1.0
        rotations, positions = _step(rotations, positions, hessian, gradient, steps, length)
    return Refined(rotations, positions, loss, hessian, scale, count)


@dataclass(frozen=True)
class _Seen:
    """What the panorama shows where the N points of K candidates project to.

    color, by_azimuth, by_elevation: (K, 3, N), as in `ImageLevel`. azimuth, elevation: (K, 6, N), derivatives of the points'
    directions by a turn (rad) and a move (m) of the camera in its own frame.
    """

    color: Tensor
    by_azimuth: Tensor
    by_elevation: Tensor
    azimuth: Tensor
    elevation: Tensor

    def with_light(self, gain: Tensor, offset: Tensor) -> "_Seen":
        """Return the same in another light: gain and offset (K, 3)."""
        gain, offset = gain[..., None], offset[..., None]
        color = torch.addcmul(offset, self.color, gain)
        return replace(self, color=color, by_azimuth=self.by_azimuth * gain, by_elevation=self.by_elevation * gain)


def _see(level: ImageLevel, place: Tensor, rotations: Tensor, positions: Tensor) -> tuple[_Seen, Tensor]:
    """Sample the level where points (K, 3, N) project to from K poses; also tell which (K, N) fall on valid pixels."""
    inverse = rotations.transpose(1, 2)
    in_camera = torch.baddbmm(-(inverse @ positions[..., None]), inverse, place)
    u, v = project(in_camera.transpose(1, 2), level.height, level.width)
    sampled = sample_planes(level.planes, u, v)
    x, y, z = in_camera.unbind(1)
    flat_square = x.square() + y.square()
    square = torch.addcmul(flat_square, z, z).clamp_min(_MIN_DISTANCE_M**2)
    per_flat = flat_square.clamp_min(1e-12).rsqrt()
    # A turn ω and a move τ take a point p to p − ω × p − τ, with f² = x² + y² and d² = x² + y² + z²:
    # ∂azimuth/∂p = (−y, x, 0) / f² and ∂elevation/∂p = (−x z / f, −y z / f, f) / d².
    per_square = per_flat * torch.maximum(flat_square, square * _MIN_COSINE**2).rsqrt()
    over_x, over_y, none = x * per_square, y * per_square, torch.zeros_like(x)
    azimuth = torch.stack((z * over_x, z * over_y, -flat_square * per_square, over_y, -over_x, none), dim=1)
    unit_x, unit_y, rise = x * per_flat, y * per_flat, z / square
    fall = -(flat_square * per_flat) / square
    elevation = torch.stack((-unit_y, unit_x, none, rise * unit_x, rise * unit_y, fall), dim=1)
    seen = _Seen(sampled[:, :3], sampled[:, 3:6], sampled[:, 6:9], azimuth, elevation)
    return seen, (sampled[:, 9] > _VALID_SHARE).to(sampled.dtype)


def _normal_equations(seen: _Seen, residual: Tensor, weights: Tensor, fit_light: bool) -> tuple[Tensor, Tensor]:
    """Return the Gauss-Newton Hessian (K, 6, 6) and gradient (K, 6) by turn and move.

    residual: (K, 3, N); weights: (K, N). The Jacobian of a channel is its derivative by azimuth times that of the azimuth by the pose, and
    the same for elevation, so channels are summed up before the products with the six unknowns.

    Gain and offset are solved for anew in every step; a step that takes them for constants crawls where light and pose pull against
    each other. So what a change of gain and offset would undo is projected out (variable projection, Golub and Pereyra 1973).
    """
    weight = weights[:, None]
    by_azimuth, by_elevation = seen.by_azimuth * weight, seen.by_elevation * weight
    both = (by_azimuth * seen.by_elevation).sum(1, keepdim=True)
    first = (by_azimuth * seen.by_azimuth).sum(1, keepdim=True) * seen.azimuth + both * seen.elevation
    second = both * seen.azimuth + (by_elevation * seen.by_elevation).sum(1, keepdim=True) * seen.elevation
    left = [first, (by_azimuth * residual).sum(1, keepdim=True)]
    right = [second, (by_elevation * residual).sum(1, keepdim=True)]
    total = weights.sum(-1).clamp_min(1e-9)[:, None]
    contrast = seen.color - ((seen.color * weight).sum(-1) / total)[..., None]
    if fit_light:
        left += [by_azimuth, by_azimuth * contrast]
        right += [by_elevation, by_elevation * contrast]
    products = torch.baddbmm(
        seen.azimuth @ torch.cat(left, dim=1).transpose(1, 2),
        seen.elevation,
        torch.cat(right, dim=1).transpose(1, 2),
    )
    hessian, gradient = products[..., :6], products[..., 6]
    if not fit_light:
        return hessian, gradient
    # Sums of the Jacobian with the derivatives by offset (1) and by gain (the contrast), per channel: (K, 6, 3) each.
    by_offset, by_gain = products[..., 7:10], products[..., 10:13]
    weighted = contrast * weight
    power = (weighted * contrast).sum(-1).clamp_min(1e-6 * total)
    light = torch.cat((by_offset / total[:, None], by_gain / power[:, None]), dim=-1)
    undone = torch.cat(((residual * weight).sum(-1), (residual * weighted).sum(-1)), dim=-1)
    hessian = hessian - light @ products[..., 7:13].transpose(1, 2)
    return hessian, gradient - (light @ undone[..., None])[..., 0]


def fit_gain_offset(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return gain and offset (K, 3) that bring `source` (K, N, 3) nearest to `target`, weighted (K, N); gains stay in 0.3..3.

    A small prior towards gain 1 keeps the fit defined where there is no contrast.
    """
    return _line_fit(source.transpose(1, 2).contiguous(), target.transpose(1, 2).contiguous(), weights)


def _line_fit(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Do what `fit_gain_offset` does for planes (K, 3, N)."""
    share = (weights / weights.sum(-1, keepdim=True).clamp_min(1e-9))[:, None]
    weighted = share * source
    mean_source, mean_target = weighted.sum(-1), (share * target).sum(-1)
    centered = weighted - share * mean_source[..., None]
    variance, covariance = (centered * source).sum(-1), (centered * target).sum(-1)
    prior = 1e-3
    gain = ((covariance + prior) / (variance.clamp_min(0) + prior)).clamp(0.3, 3.0)
    return gain, mean_target - gain * mean_source


def _weighted_median(values: Tensor, weights: Tensor) -> Tensor:
    """Return the median (K,) of values (K, N) among those of positive weight."""
    masked = torch.where(weights > 0, values, torch.full_like(values, math.nan))
    return torch.nanmedian(masked, dim=-1).values.nan_to_num(1.0)


def _step(
    rotations: Tensor, positions: Tensor, hessian: Tensor, gradient: Tensor, steps: RefinementSteps, length: float
) -> tuple[Tensor, Tensor]:
    """Solve the damped normal equations and move the poses by `length` times the solution, no further than the limits of `steps`."""
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(diagonal * steps.damping + 1e-6)
    update = -length * torch.linalg.solve(damped, gradient)
    turn, move = update[:, :3], update[:, 3:]
    turn = turn * (steps.max_turn / turn.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    move = move * (steps.max_move / move.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    moved = positions + torch.einsum("kab,kb->ka", rotations, move)
    return rotations @ rotation_from_vector(turn), moved
