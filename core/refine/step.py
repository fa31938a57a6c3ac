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

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST, StepConfig
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.level import Level
from panoloc.core.kernels.cuda import has_cuda_kernel, launch
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.refine.patches import PatchSums

_FEWEST_POINTS = 5.0  # of a patch that has a vote
_MOST_CORRELATED = 0.999
_LEAST_RATIO = 1e-4  # of a squared residual to the variance of a patch; smaller ones are noise
_THREADS, _PLANES = 384, 25  # of the kernel for GPUs: threads of a block, numbers that a step keeps of each point
_METRES = 1.5  # of a radian, or of the logarithm of a focal length, that move what is seen as far as a move does


@dataclass(frozen=True)
class PointPlanes:
    """Planes of the N points that each of K candidates aligns: positions (K, 3, N) metres, colors (K, 3, N), weights (K, N) >= 0 (zero: no
    point).

    images: (K, N) int64, which image of a rig shows each point; None of a rig of one. sums: over the patches of the sphere.

    One plane per coordinate and channel: processors and GPUs are several times faster on planes than on triples.
    """

    positions: Tensor
    colors: Tensor
    weights: Tensor
    images: Tensor | None
    sums: PatchSums

    @classmethod
    def of_triples(
        cls, positions: Tensor, colors: Tensor, weights: Tensor, images: Tensor | None, patches: Tensor
    ) -> "PointPlanes":
        """Return points of positions and colors (K, N, 3). patches: (N,) int64, ascending, which patch each point lies in."""
        planes = positions.transpose(1, 2).contiguous(), colors.transpose(1, 2).contiguous()
        return cls(planes[0], planes[1], weights, images, PatchSums(patches))

    def take(self, chosen: Tensor) -> "PointPlanes":
        """Return the points of the candidates numbered `chosen`."""
        images = None if self.images is None else self.images[chosen]
        return PointPlanes(self.positions[chosen], self.colors[chosen], self.weights[chosen], images, self.sums)

    def thinned(self, stride: int) -> "PointPlanes":
        """Return every n-th point."""
        patches = torch.unique(self.sums.patches[::stride], return_inverse=True)[1]
        images = None if self.images is None else self.images[:, ::stride].contiguous()
        positions, colors, weights = (
            each[..., ::stride].contiguous() for each in (self.positions, self.colors, self.weights)
        )
        return PointPlanes(positions, colors, weights, images, PatchSums(patches))


@dataclass(frozen=True)
class PoseStep:
    """Poses after a step, and what the step saw before it moved.

    rotations: (K, 3, 3) map_from_rig; positions: (K, 3); log_focals: (K,), None where the focal length is known. step: (K, U), turn (rad),
    move (m) and, where it is unknown, the logarithm of the focal length. equations: of the poses before.
    """

    rotations: Tensor
    positions: Tensor
    log_focals: Tensor | None
    step: Tensor
    equations: "PatchEquations"


def pose_steps(
    level: Level,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    log_focals: Tensor | None,
    config: StepConfig,
    bounds: tuple[float, float] | None = None,
    count: int = 1,
    has_last: bool = False,
) -> PoseStep:
    """Move K poses by `count` steps, and return what the last of them saw.

    log_focals: (K,), as of `Level.sample_points`; unknown as well within `bounds`, known without. has_last: the last of these steps is the
    very last of a refinement, which is not lengthened.
    """
    if _is_compiled_for(rotations):
        return _compiled_steps(level, points, rotations, positions, log_focals, config, bounds, count, has_last)
    for k in range(count):
        rules = replace(config, lengthening=1.0) if has_last and k + 1 == count else config
        found = patch_equations(level, points, rotations, positions, rules, log_focals, with_focal=bounds is not None)
        step = _solve(found if log_focals is None or bounds is None else _held(found, log_focals, bounds), rules)
        turn, move = step[:, :3], step[:, 3:6]
        positions = torch.baddbmm(positions[..., None], rotations, move[..., None])[..., 0]
        rotations = rotations @ rotation_from_vector(turn)
        if log_focals is not None and bounds is not None:
            log_focals = (log_focals + step[:, 6]).clamp(*bounds)
    return PoseStep(rotations, positions, log_focals, step, found)


def _is_compiled_for(tensor: Tensor) -> bool:
    return has_kernels_for(tensor) or has_cuda_kernel("pose_steps", tensor)


def _compiled_steps(
    level: Level,
    points: PointPlanes,
    rotations: Tensor,
    positions: Tensor,
    log_focals: Tensor | None,
    config: StepConfig,
    bounds: tuple[float, float] | None,
    count: int,
    has_last: bool = False,
) -> PoseStep:
    """Return what `pose_steps` returns, by the kernel; of no step the equations of the poses as they are."""
    size, unknowns = len(rotations), 6 if bounds is None else 7
    # The kernel moves them where they lie.
    rotations, positions = (each.clone(memory_format=torch.contiguous_format) for each in (rotations, positions))
    focals = None if log_focals is None else log_focals.clone(memory_format=torch.contiguous_format)
    hessian = rotations.new_empty((size, unknowns, unknowns))
    gradient, step = rotations.new_empty((size, unknowns)), rotations.new_empty((size, unknowns))
    mass, loss, scale = (rotations.new_empty(size) for _ in range(3))
    image = level.pixels, level.pixels.shape[1], level.rows, level.places
    cameras = level.rotations, level.centers, len(level.centers)
    starts = points.sums.starts
    aligned = points.positions, points.colors, points.weights, points.images, starts
    poses = points.weights.shape[1], len(starts) - 1, size, rotations, positions, focals, unknowns
    least, most = bounds or (0.0, 0.0)
    rules = config.robust_scale or 0, CONTRAST.noise, config.damping, config.lengthening, config.max_step_m, least, most
    found = hessian, gradient, mass, loss, scale, step
    arguments = *image, *cameras, *aligned, *poses, *map(float, rules), count, int(has_last), *found
    if has_cuda_kernel("pose_steps", rotations):
        launch("pose_steps", size, _THREADS, *arguments, rotations.new_empty((size, _PLANES, points.weights.shape[1])))
    else:
        call("pose_steps", *arguments)
    return PoseStep(rotations, positions, focals, step, PatchEquations(hessian, gradient, mass, loss, scale))


def _held(equations: "PatchEquations", log_focals: Tensor, bounds: tuple[float, float]) -> "PatchEquations":
    """Return equations in which focal lengths at a bound, beyond which the loss falls, are no unknown: the pose must not follow them."""
    slope, free = equations.gradient[:, 6], torch.ones_like(equations.gradient)
    held = ((log_focals <= bounds[0]) & (slope > 0)) | ((log_focals >= bounds[1]) & (slope < 0))
    free[:, 6] = (~held).float()
    hessian = equations.hessian * free[:, :, None] * free[:, None]
    return replace(equations, hessian=hessian, gradient=equations.gradient * free)


def _solve(equations: "PatchEquations", config: StepConfig) -> Tensor:
    """Solve the damped normal equations: steps (K, U), so much longer than the solution, but within the limits.

    Weights lag behind the pose and noise in the image's derivatives inflates the Hessian, so plain steps fall short.
    """
    hessian = equations.hessian
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(diagonal * config.damping + 1e-6)
    # Damped equations always have a solution; to check would make a GPU wait.
    update = -config.lengthening * torch.linalg.solve_ex(damped, equations.gradient)[0]
    # As a whole: a part of it alone would leave the valley that pose and focal length share.
    turn, move, spread = update[:, :3].norm(dim=-1), update[:, 3:6].norm(dim=-1), update[:, 6:].abs().sum(-1)
    longest = torch.stack((_METRES * turn, move, _METRES * spread)).amax(0) / config.max_step_m
    step: Tensor = update / longest.clamp_min(1.0)[:, None]
    return step


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
    log_focals: Tensor | None = None,
    with_focal: bool = False,
) -> PatchEquations:
    """Return the equations of a step at K poses; log_focals: as of `Level.sample_points`. with_focal: whether these are unknown."""
    if _is_compiled_for(rotations):
        bounds = (0.0, 0.0) if with_focal else None
        return _compiled_steps(level, points, rotations, positions, log_focals, config, bounds, 0).equations
    seen, inside = level.sample_points(points.positions, points.images, rotations, positions, log_focals)
    by_patch = _Patches(points, points.weights * inside)
    shown, scanned = by_patch.centered(seen.color), by_patch.centered(points.colors)
    power = [by_patch.means(_over_channels(side, side)) + CONTRAST.noise for side in (shown, scanned)]
    common = by_patch.means(_over_channels(shown, scanned))
    correlation = (common / (power[0] * power[1]).sqrt()).clamp(0, _MOST_CORRELATED)
    unexplained = (1 - correlation.square()).sqrt()
    gain = (common / power[0]).clamp_min(0)
    residual = by_patch.spread(gain)[:, None] * shown - scanned
    votes = (by_patch.mass > _FEWEST_POINTS) / (unexplained * power[1])
    weights = by_patch.weights * by_patch.spread(votes)
    if config.robust_scale is not None:
        relative = _over_channels(residual, residual) / by_patch.spread(power[1])
        weights = weights * _robust(relative, by_patch.weights, config.robust_scale)
    derivatives = seen.derivatives * by_patch.spread(gain)[:, None, None]
    directions = seen.directions if with_focal else seen.directions[:, :6]
    hessian, gradient = by_patch.normal_equations(directions, derivatives, residual, shown, weights)
    total = by_patch.mass.sum(-1).clamp_min(1e-9)
    loss = (by_patch.mass * unexplained).sum(-1) / total
    scale = ((weights * _over_channels(residual, residual)).sum(-1) / total).sqrt()
    return PatchEquations(hessian, gradient, total, loss, scale)


def _robust(relative: Tensor, weights: Tensor, scale: float) -> Tensor:
    """Return by how much less each point (K, N) counts (Geman-McClure), from squared residuals over the variance of its patch."""
    median = torch.where(weights > 0, relative, torch.nan).nanmedian(-1).values.nan_to_num(1.0)
    ratio = relative / (scale**2 * median.clamp_min(_LEAST_RATIO))[:, None]
    return 1 / (1 + ratio).square()


def _over_channels(first: Tensor, second: Tensor) -> Tensor:
    """Return the product of (K, ..., 3, N) and (K, ..., 3, N) summed over channels, (K, ..., N)."""
    red = first[..., 0, :] * second[..., 0, :]
    return red.addcmul_(first[..., 1, :], second[..., 1, :]).addcmul_(first[..., 2, :], second[..., 2, :])


class _Patches:
    """The points of K candidates by patch."""

    def __init__(self, points: PointPlanes, weights: Tensor) -> None:
        self.weights = weights  # (K, N)
        self._sums, self.spread = points.sums, points.sums.spread
        self.mass = self._sums(weights).clamp_min(1e-6)  # (K, P)

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
