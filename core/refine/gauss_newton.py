"""One step of damped Gauss-Newton on the robust sampling loss, for many candidates at once.

A step samples the panorama where the points of each candidate project to, fits gain and offset per channel (light differs between scan
and photo), weighs residuals down that no pose explains (changed furniture), and solves 6 x 6 normal equations.

Paper: §3.3, Eq. 5 (sampling loss).
Deviation: the paper runs Adam on all points at full resolution for 100 steps. The Jacobian of the loss is known in closed form and
the problem has six unknowns, so second-order steps from coarse to fine need an order of magnitude fewer evaluations.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import StepConfig
from panoloc.core.features.light_fit import fit_planes, weighted_sums
from panoloc.core.features.line_hold import LineHold
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.image_level import ImageLevel
from panoloc.core.refine.patch_sums import PatchSums
from panoloc.core.refine.point_sampling import SampledPoints, sample_points
from panoloc.core.refine.rig_level import RigLevel


@dataclass(frozen=True)
class StepHistory:
    """How the last step of each of K candidates went.

    step: (K, 6), turn (rad) and move (m), zero before the first. slope: (K,), of the loss along it where it began. relaxation: (K,), the
    factor that it was lengthened by.
    """

    step: Tensor
    slope: Tensor
    relaxation: Tensor

    def take(self, chosen: Tensor) -> "StepHistory":
        """Return some of the candidates."""
        return StepHistory(self.step[chosen], self.slope[chosen], self.relaxation[chosen])


def initial_history(count: int, config: StepConfig, device: torch.device) -> StepHistory:
    """Return the history of `count` candidates that have not moved yet."""
    nothing = torch.zeros(count, device=device)
    return StepHistory(torch.zeros((count, 6), device=device), nothing, torch.full_like(nothing, config.relaxation))


@dataclass(frozen=True)
class PointPlanes:
    """Planes of the N points that each of K candidates aligns: positions (K, 3, N) metres, colors (K, 3, N), weights (K, N) >= 0.

    photos: (K, N), as in `CandidatePoints`. sums: over the patches, where there are any. lines: as in `CandidatePoints`.

    One plane per coordinate and channel: processors and GPUs are several times faster on planes than on triples.
    """

    positions: Tensor
    colors: Tensor
    weights: Tensor
    photos: Tensor | None = None
    sums: PatchSums | None = None
    lines: LineHold | None = None

    def take(self, chosen: Tensor) -> "PointPlanes":
        """Return the points of some of the candidates."""
        photos = None if self.photos is None else self.photos[chosen]
        lines = None if self.lines is None else self.lines.take(chosen)
        positions, colors, weights = self.positions[chosen], self.colors[chosen], self.weights[chosen]
        return PointPlanes(positions, colors, weights, photos, self.sums, lines)


@dataclass(frozen=True)
class PoseStep:
    """Poses after a step, and what the step saw before it moved.

    rotations: (K, 3, 3) map_from_camera; positions: (K, 3). history: how it went. weights: (K, N), robust.
    hessian: (K, 6, 6) of half the weighted squared residuals by turn and move. ratio: (K, N), squared residuals over the squared
    scale. base: (K, N), weights of the points in view. scale: (K,), the residual at which a point counts a quarter.
    """

    rotations: Tensor
    positions: Tensor
    history: StepHistory
    weights: Tensor
    hessian: Tensor
    ratio: Tensor
    base: Tensor
    scale: Tensor

    @property
    def loss(self) -> Tensor:
        """Return the robust loss (K,) in 0..1."""
        return (self.base * self.ratio / (1 + self.ratio)).sum(-1) / self.base.sum(-1).clamp_min(1e-9)


def gauss_newton_step(
    level: ImageLevel | RigLevel,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    light_weights: Tensor,
    history: StepHistory,
    config: StepConfig,
    relaxed: bool,
) -> PoseStep:
    """Move K poses by one step.

    light_weights: (K, N), robust weights of the step before, which light is fitted with. history: of the step before. relaxed: whether
    to lengthen the step.
    """
    if isinstance(level, RigLevel):
        seen, inside = level.sample_points(points.positions, points.photos, rotations, positions)
    else:
        seen, inside = sample_points(level, points.positions, rotations, positions)
    base = points.weights * inside
    if config.fit_light:
        seen.apply_gain_offset(*fit_planes(seen.color, points.colors, light_weights * inside))
    residual = seen.color - points.colors
    squared = _over_channels(residual, residual)[:, 0]
    scale = (config.robust_scale * _weighted_median(squared, base, config.median_points).sqrt()).clamp_min(
        config.min_residual
    )
    ratio = squared / scale.square()[:, None]
    weights = base / (1 + ratio).square_()  # Geman-McClure: bounded influence
    hessian, gradient = normal_equations(seen, residual, weights, config.fit_light)
    relaxation = next_relaxation(history, gradient, config)
    turn, move = solve(hessian, gradient, config, relaxation if relaxed else torch.ones_like(relaxation))
    step = torch.cat((turn, move), dim=-1)
    history = StepHistory(step, (gradient * step).sum(-1), relaxation)
    moved = torch.baddbmm(positions[..., None], rotations, move[..., None])[..., 0]
    turned = rotations @ rotation_from_vector(turn)
    return PoseStep(turned, moved, history, weights, hessian, ratio, base, scale)


def normal_equations(seen: SampledPoints, residual: Tensor, weights: Tensor, fit_light: bool) -> tuple[Tensor, Tensor]:
    """Return the Gauss-Newton Hessian (K, 6, 6) and gradient (K, 6) by turn and move, or of as many unknowns as `seen` has directions.

    residual: (K, 3, N); weights: (K, N). The Jacobian of a channel is its derivative by azimuth times that of the azimuth by the pose, and
    the same for elevation, so channels are summed up before the products with the six unknowns.

    Gain and offset are solved for anew in every step; a step that takes them for constants crawls where light and pose pull against
    each other. So what a change of gain and offset would undo is projected out (variable projection, Golub and Pereyra 1973).
    """
    # Rows, in place: those of the unknowns, one of the residual, three each of offset and gain; each by azimuth and by elevation.
    count = seen.directions.shape[1]
    rows = weights.new_empty((len(weights), count + (7 if fit_light else 4), 2, weights.shape[1]))
    derivatives = seen.derivatives
    weighted = torch.mul(derivatives, weights[:, None, None], out=rows[:, count + 1 : count + 4])
    by_azimuth = _over_channels(weighted[:, :, :1], derivatives)
    by_elevation = _over_channels(weighted[:, :, 1:], derivatives)
    torch.mul(seen.directions[:, :, :1], by_azimuth, out=rows[:, :count]).addcmul_(
        seen.directions[:, :, 1:], by_elevation
    )
    rows[:, count : count + 1] = _over_channels(weighted, residual[:, :, None])
    total = weights.sum(-1).clamp_min(1e-9)[:, None]
    contrast = seen.color - (weighted_sums(seen.color, weights) / total)[..., None]
    if fit_light:
        torch.mul(weighted, contrast[:, :, None], out=rows[:, count + 4 :])
    products = torch.bmm(rows.flatten(2), seen.directions.flatten(2).transpose(1, 2))
    hessian, gradient = products[:, :count], products[:, count]
    if not fit_light:
        return hessian, gradient
    # Sums of the Jacobian with the derivatives by offset (1) and by gain (the contrast), per channel: (K, 3, 6) each.
    spread = contrast * weights[:, None]
    power = (spread * contrast).sum(-1).clamp_min(1e-6 * total)
    light = products[:, count + 1 :] / torch.cat((total.expand(-1, 3), power), dim=-1)[..., None]
    undone = torch.cat((weighted_sums(residual, weights), (residual * spread).sum(-1)), dim=-1)
    hessian = hessian - products[:, count + 1 :].transpose(1, 2) @ light
    return hessian, gradient - (undone[:, None] @ light)[:, 0]


def _over_channels(first: Tensor, second: Tensor) -> Tensor:
    """Return the product of (K, 3, ...) and (K, 3, ...) summed over channels, (K, 1, ...)."""
    red = first[:, :1] * second[:, :1]
    return red.addcmul_(first[:, 1:2], second[:, 1:2]).addcmul_(first[:, 2:], second[:, 2:])


def _weighted_median(values: Tensor, weights: Tensor, count: int) -> Tensor:
    """Return the median (K,) of values (K, N) among those of positive weight; of many values, of about `count` spread evenly."""
    stride = max(1, values.shape[1] // count)
    masked = torch.where(weights[:, ::stride] > 0, values[:, ::stride], math.nan)
    return torch.nanmedian(masked, dim=-1).values.nan_to_num(1.0)


def next_relaxation(history: StepHistory, gradient: Tensor, config: StepConfig) -> Tensor:
    """Return the factor (K,) that the next step is lengthened by, from the gradient (K, 6) where the last one led.

    Weights lag behind the pose and noise in the image's derivatives inflates the Hessian, so plain steps fall short, at full
    resolution to a third of the way. Where the loss still falls along the last step, a line through its slopes at both ends says how
    much longer it should have been (the secant rule).
    """
    slope = (gradient * history.step).sum(-1)
    missed = torch.where(slope > history.slope, history.slope / (history.slope - slope).clamp_max(-1e-12), 2.0).clamp(
        0.5, 2.0
    )
    longer = (history.relaxation * missed).clamp(1.0, config.max_relaxation)
    return torch.where(history.slope < 0, longer, history.relaxation)


def solve(hessian: Tensor, gradient: Tensor, config: StepConfig, relaxation: Tensor) -> tuple[Tensor, Tensor]:
    """Solve the damped normal equations: turns and moves (K, 3), `relaxation` (K,) times the solution but within the limits."""
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(diagonal * config.damping + 1e-6)
    # Damped equations always have a solution; to check would make a GPU wait.
    update = -relaxation[:, None] * torch.linalg.solve_ex(damped, gradient)[0]
    turn, move = update[:, :3], update[:, 3:]
    turn = turn * (config.max_turn_rad / turn.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    move = move * (config.max_move_m / move.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    return turn, move
