"""The judge: how well the scan, rendered at a refined pose, agrees with the panorama.

Losses of candidates cannot be compared: each is measured on its own points. Here every candidate is rendered anew at its own pose, so the
points are those that a camera there would see, and the two images are compared by measures that no gain, offset or tone curve moves.

Deviation from the paper (smallest sampling loss wins): on the hardest shared queries the right candidate has the smallest loss in 0.29 of
the cases and the best agreement in 1.00 (docs/experiments.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from panoloc.core.config import CONTRAST, DescriptorConfig, JudgeConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.render.comparison import Comparison


def correlation(first: Tensor, second: Tensor, share: Tensor, joint_channels: bool = False) -> Tensor:
    """Return weighted correlations (..., C), or (..., 1) over all channels together, of (..., S, C) with shares (..., S); contrast that is
    noise is little correlated."""
    weight = share[..., None]
    first = first - (weight * first).sum(-2, keepdim=True)
    second = second - (weight * second).sum(-2, keepdim=True)
    covariance = (weight * first * second).sum(-2)
    variances = (weight * first.square()).sum(-2), (weight * second.square()).sum(-2)
    if joint_channels:
        covariance = covariance.sum(-1, keepdim=True)
        variances = variances[0].sum(-1, keepdim=True), variances[1].sum(-1, keepdim=True)
    return covariance / ((variances[0] + CONTRAST.noise) * (variances[1] + CONTRAST.noise)).sqrt()


def correlation_in_patches(patches: Tensor) -> tuple[Tensor, Tensor]:
    """Return the correlation (K, P) inside each of the patches (K, P, S, 7), of colours, colours and shares, and their shares (K, P)."""
    weight = patches[..., 6]
    mass = weight.sum(-1)
    share = weight / mass.clamp_min(1e-12)[..., None]
    inside = correlation(patches[..., :3], patches[..., 3:6], share, joint_channels=True)
    return inside[..., 0], mass


def in_patches(values: Tensor, window: SphereWindow, side: int, before: int = 0) -> Tensor:
    """Reorder pixels (K, H W, C) of a window to (K, patches, pixels of a patch, C).

    Patches are `side` pixels high and wide; the first begins `before` pixels above and left of the window, beyond which all is zero.
    """
    batch, _, channels = values.shape
    below, right = -(window.height + before) % side, -(window.width + before) % side
    image = values.view(batch, window.height, window.width, channels)
    image = torch.nn.functional.pad(image, (0, 0, before, right, before, below))
    grid = image.unfold(1, side, side).unfold(2, side, side)  # (K, rows, columns, C, side, side)
    return grid.flatten(4).transpose(3, 4).flatten(1, 2)


@dataclass(frozen=True)
class Agreement:
    """Measures of agreement for K candidates, each (K,), larger is better.

    correlation: mean over channels of the correlation of all pixels. patch_correlation: solid-angle mean over patches of the
    correlation inside a patch. explained: likewise, of the share of a patch's contrast that the other side explains, 0..1. score: what
    candidates are ranked by. coverage: share of the sphere that was compared. relative_coverage: the same of what was photographed, at
    most 1. lines: how well lines agree with the rotation, 0..1; None where they are not asked.
    """

    correlation: Tensor
    patch_correlation: Tensor
    coverage: Tensor
    relative_coverage: Tensor
    explained: Tensor
    score: Tensor
    lines: Tensor | None = None


def agreement(
    comparison: Comparison, config: JudgeConfig, share: Tensor | float, patch_deg: float, lines: Tensor | None = None
) -> Agreement:
    """Measure how well the two sides of a comparison agree.

    share: of the sphere, that was photographed. patch_deg: degrees that a patch is high and wide. lines: (K,), as in `Agreement`.
    """
    side = round(comparison.views.window.rows * patch_deg / 180)
    total, correlation_of_all, inside, explained = _measures(comparison, side)
    coverage = total / (4 * torch.pi)
    relative_coverage = (coverage / share).clamp(0, 1)
    score = 2 * explained * relative_coverage.sqrt()
    if lines is not None:
        score = score * (1 - config.lines_share * (1 - lines))
    return Agreement(correlation_of_all, inside, coverage, relative_coverage, explained, score, lines)


def _measures(comparison: Comparison, side: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return, each (K,), the sum of weights, and correlation, patch_correlation and explained of `Agreement`; side: of a patch, pixels."""
    return (_compiled if has_kernels_for(comparison.scan) else _measured)(comparison, side)


def _measured(comparison: Comparison, side: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return what `_measures` returns, by tensors."""
    scan, seen, window = comparison.scan, comparison.seen, comparison.views.window
    total = comparison.weights.sum(-1, keepdim=True).clamp_min(1e-9)
    pixel_share = comparison.weights / total
    sides = torch.cat((scan, seen, pixel_share[..., None]), dim=-1)
    # In patches that begin in the middle of those as well: a photo has thirty, and where their borders lie decides much.
    first = correlation_in_patches(in_patches(sides, window, side))
    again = correlation_in_patches(in_patches(sides, window, side, side // 2))
    inside, mass = torch.cat((first[0], again[0]), dim=1), torch.cat((first[1], again[1]), dim=1) / 2
    # Of what a patch shows, in standard deviations. Where much has changed, averages of correlations reward poses at which everything
    # agrees a little; this rewards those at which something agrees.
    explained = ((1 - (1 - inside.clamp(0, 1).square()).sqrt()) * mass).sum(-1)
    of_all = correlation(scan, seen, pixel_share).mean(-1)
    return total[:, 0], of_all, (inside * mass).sum(-1), explained


def _compiled(comparison: Comparison, side: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return what `_measures` returns, by the kernel."""
    window, count = comparison.views.window, len(comparison.scan)
    measured = comparison.scan.new_empty((count, 4))
    images = comparison.scan, comparison.seen, comparison.weights
    call("agreement", *images, count, window.height, window.width, side, CONTRAST.noise, measured)
    total, of_all, inside, explained = measured.unbind(1)
    return total, of_all, inside, explained


def with_agreement(group: Sequence[Hypothesis], measured: Agreement) -> list[Hypothesis]:
    """Return the hypotheses (K) with their score and measures."""
    names = [f.name for f in fields(measured) if f.name != "score" and getattr(measured, f.name) is not None]
    columns = torch.stack([measured.score, *(getattr(measured, name) for name in names)], dim=1)
    return [
        replace(h, score=score, measures=dict(zip(names, values, strict=True)))
        for h, (score, *values) in zip(group, columns.tolist(), strict=True)
    ]


@dataclass(frozen=True)
class PhotoAgreement:
    """What a photo shows of the scan, against the scan seen from its pose.

    correlation: of all pixels, −1..1. explained: as of `Agreement`. contrast: standard deviation of its colours inside patches.
    """

    correlation: float
    explained: float
    contrast: float

    @property
    def share_explained(self) -> float:
        """Return how much the scan explains of the contrast above noise; all of it where there is none."""
        contrast = self.contrast - math.sqrt(CONTRAST.noise)
        return self.explained / contrast if contrast > 0 else math.inf

    def contradicts(self, config: JudgeConfig) -> bool:
        """Tell whether the photo cannot be of where it is said to be: it shows much, of which the scan explains next to nothing."""
        return self.share_explained < config.least_explained


def agreement_by_photo(comparison: Comparison, count: int, config: DescriptorConfig) -> list[PhotoAgreement | None]:
    """Return how each of `count` photos agrees with the scan at the one pose compared; None where nothing is in view."""
    each = [replace(comparison, weights=comparison.weights * (comparison.image == number)) for number in range(count)]
    return [_of_photo(alone, config.patch_deg) if float(alone.weights.sum()) > 0 else None for alone in each]


def _of_photo(comparison: Comparison, patch_deg: float) -> PhotoAgreement:
    """Measure the one photo whose pixels have weights (1, S)."""
    window = comparison.views.window
    side = round(window.rows * patch_deg / 180)
    total, correlation_of_all, _, explained = _measures(comparison, side)
    share = in_patches(comparison.weights[..., None] / total[:, None, None], window, side)
    mass = share.sum((-2, -1))
    within, colors = share / mass.clamp_min(1e-12)[..., None, None], in_patches(comparison.seen, window, side)
    spread = (within * (colors - (within * colors).sum(-2, keepdim=True)).square()).sum((-2, -1)).sqrt()
    return PhotoAgreement(float(correlation_of_all), float(explained), float((spread * mass).sum()))
