"""One step of damped Gauss-Newton on the contrast that images explain, patch by patch, for many candidates at once.

Points are taken together that lie in one patch of the sphere. Each patch has a gain and offsets of its own, for light differs between scan
and photo from lamp to lamp, and loses its vote the less it agrees: what is minimized is the sum of √(1 − c²) over patches, with c the
correlation inside a patch, which is what candidates are ranked by.

Paper: §3.3, Eq. 5 (sampling loss).
Deviation: the paper runs Adam on all points at full resolution for 100 steps. The Jacobian of the loss is known in closed form and
the problem has six unknowns, so second-order steps from coarse to fine need an order of magnitude fewer evaluations. One light for all of
the image and a loss of single points are not enough where most of it has changed: poses at which everything agrees a little beat the one
at which some of it agrees well. Of 16 photos of rooms of which 60 % had changed 8 stayed at the true pose, with patches 13
(docs/experiments.md).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import StepConfig
from panoloc.core.features.line_hold import LineHold
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.level import Level
from panoloc.core.refine.patch_sums import PatchSums

_FEWEST_POINTS = 5.0  # of a patch that has a vote
_MOST_CORRELATED = 0.999


@dataclass(frozen=True)
class StepHistory:
    """How the last step of each of K candidates went.

    step: (K, 6), turn (rad) and move (m), zero before the first. slope: (K,), of the loss along it where it began. relaxation: (K,), the
    factor that it was lengthened by.
    """

    step: Tensor
    slope: Tensor
    relaxation: Tensor

    @staticmethod
    def initial(count: int, config: StepConfig, device: torch.device) -> "StepHistory":
        """Return the history of `count` candidates that have not moved yet."""
        nothing = torch.zeros(count, device=device)
        return StepHistory(torch.zeros((count, 6), device=device), nothing, torch.full_like(nothing, config.relaxation))

    def take(self, chosen: Tensor) -> "StepHistory":
        """Return some of the candidates."""
        return StepHistory(self.step[chosen], self.slope[chosen], self.relaxation[chosen])


@dataclass(frozen=True)
class PointPlanes:
    """Planes of the N points that each of K candidates aligns: positions (K, 3, N) metres, colors (K, 3, N), weights (K, N) >= 0.

    images: (K, N), as in `CandidatePoints`. sums: over the patches. lines: as in `CandidatePoints`.

    One plane per coordinate and channel: processors and GPUs are several times faster on planes than on triples.
    """

    positions: Tensor
    colors: Tensor
    weights: Tensor
    images: Tensor | None
    sums: PatchSums
    lines: LineHold | None = None

    def take(self, chosen: Tensor) -> "PointPlanes":
        """Return the points of some of the candidates."""
        images = None if self.images is None else self.images[chosen]
        lines = None if self.lines is None else self.lines.take(chosen)
        return PointPlanes(self.positions[chosen], self.colors[chosen], self.weights[chosen], images, self.sums, lines)


@dataclass(frozen=True)
class PoseStep:
    """Poses after a step, and what the step saw before it moved.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3). history: how it went. equations: of the poses before.
    """

    rotations: Tensor
    positions: Tensor
    history: StepHistory
    equations: "PatchEquations"


def pose_step(
    level: Level,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    history: StepHistory,
    config: StepConfig,
    relaxed: bool,
) -> PoseStep:
    """Move K poses by one step. history: of the step before. relaxed: whether to lengthen the step."""
    found = patch_equations(level, points, rotations, positions, config)
    relaxation = _next_relaxation(history, found.gradient, config)
    turn, move = _solve(found, config, relaxation if relaxed else torch.ones_like(relaxation))
    step = torch.cat((turn, move), dim=-1)
    return PoseStep(
        rotations @ rotation_from_vector(turn),
        torch.baddbmm(positions[..., None], rotations, move[..., None])[..., 0],
        StepHistory(step, (found.gradient * step).sum(-1), relaxation),
        found,
    )


def _next_relaxation(history: StepHistory, gradient: Tensor, config: StepConfig) -> Tensor:
    """Return the factor (K,) that the next step is lengthened by, from the gradient (K, 6) where the last one led.

    Weights lag behind the pose and noise in the image's derivatives inflates the Hessian, so plain steps fall short. Where the loss still
    falls along the last step, a line through its slopes at both ends says how much longer it should have been (the secant rule).
    """
    slope = (gradient * history.step).sum(-1)
    missed = torch.where(slope > history.slope, history.slope / (history.slope - slope).clamp_max(-1e-12), 2.0)
    longer = (history.relaxation * missed.clamp(0.5, 2.0)).clamp(1.0, config.max_relaxation)
    return torch.where(history.slope < 0, longer, history.relaxation)


def _solve(equations: "PatchEquations", config: StepConfig, relaxation: Tensor) -> tuple[Tensor, Tensor]:
    """Solve the damped normal equations: turns and moves (K, 3), `relaxation` (K,) times the solution but within the limits."""
    hessian = equations.hessian
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(diagonal * config.damping + 1e-6)
    # Damped equations always have a solution; to check would make a GPU wait.
    update = -relaxation[:, None] * torch.linalg.solve_ex(damped, equations.gradient)[0]
    turn, move = update[:, :3], update[:, 3:]
    turn = turn * (config.max_turn_rad / turn.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    move = move * (config.max_move_m / move.norm(dim=-1, keepdim=True).clamp_min(1e-12)).clamp(max=1.0)
    return turn, move


@dataclass(frozen=True)
class PatchEquations:
    """The equations of a step at K poses.

    hessian (K, U, U) and gradient (K, U) by turn, move and, where it is asked for, the logarithm of the focal length, of `mass` (K,) times
    the loss. loss: (K,) in 0..1, mean of √(1 − c²) over patches. scale: (K,), weighted residual of a point.
    """

    hessian: Tensor
    gradient: Tensor
    mass: Tensor
    loss: Tensor
    scale: Tensor


def patch_equations(
    level: Level,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    config: StepConfig,
    log_focal: Tensor | None = None,
) -> PatchEquations:
    """Return the equations of a step at K poses; log_focal: as of `Level.sample_points`."""
    seen, inside = level.sample_points(points.positions, points.images, rotations, positions, log_focal)
    by_patch = _Patches(points, points.weights * inside)
    shown, scanned = by_patch.centered(seen.color), by_patch.centered(points.colors)
    common, power = by_patch.covariances(shown, scanned, config.min_variance)
    correlation = (common / (power[0] * power[1]).sqrt()).clamp(0, _MOST_CORRELATED)
    unexplained = (1 - correlation.square()).sqrt()
    gain = (common / power[0]).clamp_min(0)
    residual = by_patch.spread(gain)[:, None] * shown - scanned
    votes = (by_patch.mass > _FEWEST_POINTS) / (unexplained * power[1])
    weights = by_patch.weights * by_patch.spread(votes)
    if config.robust_scale is not None:
        relative = _over_channels(residual, residual) / by_patch.spread(power[1])
        weights = weights * _robust(relative, by_patch.weights, config.robust_scale, config.min_ratio)
    derivatives = seen.derivatives * by_patch.spread(gain)[:, None, None]
    hessian, gradient = by_patch.normal_equations(seen.directions, derivatives, residual, shown, weights)
    total = by_patch.mass.sum(-1).clamp_min(1e-9)
    if points.lines is not None:
        by_turn, slope = points.lines.equations(rotations)
        hessian[:, :3, :3] += by_turn * total[:, None, None]
        gradient[:, :3] += slope * total[:, None]
    loss = (by_patch.mass * unexplained).sum(-1) / total
    scale = ((weights * _over_channels(residual, residual)).sum(-1) / total).sqrt()
    return PatchEquations(hessian, gradient, total, loss, scale)


def _robust(relative: Tensor, weights: Tensor, scale: float, floor: float) -> Tensor:
    """Return by how much less each point (K, N) counts (Geman-McClure), from squared residuals over the variance of its patch."""
    median = torch.where(weights > 0, relative, torch.nan).nanmedian(-1).values.nan_to_num(1.0)
    ratio = relative / (scale**2 * median.clamp_min(floor))[:, None]
    return 1 / (1 + ratio).square()


def _over_channels(first: Tensor, second: Tensor) -> Tensor:
    """Return the product of (K, ..., 3, N) and (K, ..., 3, N) summed over channels, (K, ..., N)."""
    red = first[..., 0, :] * second[..., 0, :]
    return red.addcmul_(first[..., 1, :], second[..., 1, :]).addcmul_(first[..., 2, :], second[..., 2, :])


class _Patches:
    """The points of K candidates by patch."""

    def __init__(self, points: PointPlanes, weights: Tensor) -> None:
        self.weights = weights  # (K, N)
        self._sums = points.sums
        self.mass = self._sums(weights).clamp_min(1e-6)  # (K, P)

    def covariances(self, shown: Tensor, scanned: Tensor, floor: float) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Return the covariance (K, P) of centred planes (K, 3, N) over all channels, and the variances of both plus `floor`."""
        power = self.means(_over_channels(shown, shown)) + floor, self.means(_over_channels(scanned, scanned)) + floor
        return self.means(_over_channels(shown, scanned)), power

    def spread(self, values: Tensor) -> Tensor:
        """Return values of patches (..., P) as those of their points (..., N)."""
        return self._sums.spread(values)

    def means(self, values: Tensor) -> Tensor:
        """Return the weighted means (K, P) of values (K, N)."""
        return self._sums(values * self.weights) / self.mass

    def centered(self, planes: Tensor) -> Tensor:
        """Return planes (K, C, N) less their weighted means in each patch."""
        means = self._sums(planes * self.weights[:, None]) / self.mass[:, None]
        return planes - self.spread(means)

    def normal_equations(
        self, directions: Tensor, derivatives: Tensor, residual: Tensor, shown: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the Hessian (K, U, U) and gradient (K, U) less what offsets and gain of each patch would undo (variable projection,
        Golub and Pereyra 1973).

        directions: (K, U, 2, N), as of `SampledPoints`; derivatives of the residual by azimuth and by elevation: (K, 3, 2, N); residual
        and shown, centred colours of the images: (K, 3, N); weights: (K, N).
        """
        count = directions.shape[1]
        # The Jacobian, and the residual as one more row of the same products; written in place, for memory is what takes the time.
        rows = residual.new_empty((len(residual), count + 1, *residual.shape[1:]))
        across, up = derivatives[:, None, :, 0], derivatives[:, None, :, 1]
        torch.mul(directions[:, :, :1], across, out=rows[:, :count]).addcmul_(directions[:, :, 1:], up)
        rows[:, count] = residual
        weighted = rows * weights[:, None, None]
        products = weighted.flatten(2) @ rows.flatten(2).transpose(1, 2)
        by_offsets = self._sums(weighted)  # (K, U + 1, 3, P)
        by_gain = self._sums(_over_channels(weighted, shown[:, None]))  # (K, U + 1, P)
        total = self._sums(weights).clamp_min(1e-9)
        power = self._sums(_over_channels(shown, shown) * weights).clamp_min(1e-9)
        undone = torch.cat(
            (by_offsets * total.rsqrt()[:, None, None], (by_gain * power.rsqrt()[:, None])[:, :, None]), 2
        )
        products = products - undone.flatten(2) @ undone.flatten(2).transpose(1, 2)
        return products[:, :count, :count], products[:, :count, count]
