"""The judge: how well the scan, rendered at a refined pose, agrees with the panorama.

Losses of candidates cannot be compared: each is measured on its own points. Here every candidate is rendered anew at its own pose, so the
points are those that a camera there would see, and the two images are compared by measures that no gain, offset or tone curve moves.

Deviation from the paper (smallest sampling loss wins): on the hardest shared queries the right candidate has the smallest loss in 0.29 of
the cases and the best agreement in 1.00 (docs/experiments.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.decide.patch_correlation import correlation, correlation_in_patches, in_patches, in_shifted_patches
from panoloc.core.render.comparison import Comparison


@dataclass(frozen=True)
class Agreement:
    """Measures of agreement for K candidates, each (K,), larger is better.

    correlation: mean over channels of the correlation of all pixels. patch_correlation: solid-angle mean over patches of the
    correlation inside a patch. explained: likewise, of the share of a patch's contrast that the other side explains, 0..1. score: what
    candidates are ranked by. mutual_information: nats, of brightness. inlier_share: of the pixels, by colour. coverage: share of the
    sphere that was compared. relative_coverage: the same of what was photographed, at most 1.
    """

    correlation: Tensor
    patch_correlation: Tensor
    mutual_information: Tensor
    inlier_share: Tensor
    coverage: Tensor
    relative_coverage: Tensor
    explained: Tensor
    score: Tensor


def agreement(comparison: Comparison, config: JudgeConfig, share: float = 1.0) -> Agreement:
    """Measure how well the two sides of a comparison agree. share: of the sphere, that was photographed."""
    scan, panorama = comparison.scan, comparison.panorama
    total = comparison.weights.sum(-1, keepdim=True).clamp_min(1e-9)
    pixel_share = comparison.weights / total
    of_all = correlation(scan, panorama, pixel_share, config.min_variance).mean(-1)
    window = comparison.views.window
    sides = torch.cat((scan, panorama, pixel_share[..., None]), dim=-1)
    side, floor = window.rows // config.patch_rows, config.min_patch_variance
    inside, mass = correlation_in_patches(in_patches(sides, window.height, side), floor)
    if config.shifted_patches:
        again = correlation_in_patches(in_shifted_patches(sides, window, side), floor)
        inside, mass = torch.cat((inside, again[0]), dim=1), torch.cat((mass, again[1]), dim=1) / 2
    coverage = total[:, 0] / (4 * torch.pi)
    distance_square = (scan - panorama).square().sum(-1) / config.inlier_difference**2
    relative_coverage = (coverage / share).clamp(0, 1)
    patch_correlation = (inside * mass).sum(-1)
    # Of what a patch shows, in standard deviations. Where much has changed, averages of correlations reward poses at which everything
    # agrees a little; this rewards those at which something agrees.
    explained = ((1 - (1 - inside.clamp(0, 1).square()).sqrt()) * mass).sum(-1)
    rank = 2 * explained if config.ranks_by_explained else of_all + patch_correlation
    return Agreement(
        of_all,
        patch_correlation,
        _mutual_information(scan.mean(-1), panorama.mean(-1), pixel_share, config.brightness_bins),
        (pixel_share / (1 + distance_square)).sum(-1),
        coverage,
        relative_coverage,
        explained,
        rank * relative_coverage.sqrt(),
    )


def likeness(here: Comparison, there: Comparison, config: JudgeConfig, share: float) -> float:
    """Return the score of the scan as photos would show it at one pose beside the scan as they would show it at another.

    Both compared at one pose of the rig, in the same window of its axes: their pixels are the same directions.
    """
    both = here.weights * (there.weights > 0)
    return float(agreement(replace(here, panorama=there.scan, weights=both), config, share).score)


def _mutual_information(first: Tensor, second: Tensor, share: Tensor, bins: int) -> Tensor:
    """Return the mutual information (K,) in nats of two brightness images (K, S) in 0..1, by a joint histogram."""
    cell = (first * bins).long().clamp(0, bins - 1) * bins + (second * bins).long().clamp(0, bins - 1)
    joint = torch.zeros((len(first), bins * bins), device=first.device).scatter_add_(1, cell, share)
    joint = joint.view(-1, bins, bins)
    independent = joint.sum(2, keepdim=True) * joint.sum(1, keepdim=True)
    return (joint * ((joint + 1e-12) / (independent + 1e-12)).log()).sum((1, 2))


def with_agreement(group: Sequence[Hypothesis], measured: Agreement) -> list[Hypothesis]:
    """Return the hypotheses (K) with their score and measures."""
    names = [field.name for field in fields(measured) if field.name != "score"]
    columns = torch.stack([measured.score, *(getattr(measured, name) for name in names)], dim=1)
    return [
        replace(h, score=score, measures=dict(zip(names, values, strict=True)))
        for h, (score, *values) in zip(group, columns.tolist(), strict=True)
    ]
