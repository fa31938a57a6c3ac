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
    comparison: Comparison, config: JudgeConfig, share: float, patch_deg: float, lines: Tensor | None = None
) -> Agreement:
    """Measure how well the two sides of a comparison agree.

    share: of the sphere, that was photographed. patch_deg: degrees that a patch is high and wide. lines: (K,), as in `Agreement`.
    """
    scan, seen = comparison.scan, comparison.seen
    total = comparison.weights.sum(-1, keepdim=True).clamp_min(1e-9)
    pixel_share = comparison.weights / total
    window = comparison.views.window
    sides = torch.cat((scan, seen, pixel_share[..., None]), dim=-1)
    side, floor = round(window.rows * patch_deg / 180), config.min_patch_variance
    # In patches that begin in the middle of those as well: a photo has thirty, and where their borders lie decides much.
    first = correlation_in_patches(in_patches(sides, window.height, side), floor)
    again = correlation_in_patches(in_shifted_patches(sides, window, side), floor)
    inside, mass = torch.cat((first[0], again[0]), dim=1), torch.cat((first[1], again[1]), dim=1) / 2
    coverage = total[:, 0] / (4 * torch.pi)
    relative_coverage = (coverage / share).clamp(0, 1)
    # Of what a patch shows, in standard deviations. Where much has changed, averages of correlations reward poses at which everything
    # agrees a little; this rewards those at which something agrees.
    explained = ((1 - (1 - inside.clamp(0, 1).square()).sqrt()) * mass).sum(-1)
    score = 2 * explained * relative_coverage.sqrt()
    if lines is not None:
        score = score * (1 - config.lines_share * (1 - lines))
    return Agreement(
        correlation(scan, seen, pixel_share, config.min_variance).mean(-1),
        (inside * mass).sum(-1),
        coverage,
        relative_coverage,
        explained,
        score,
        lines,
    )


def likeness(here: Comparison, there: Comparison, config: JudgeConfig, share: float, patch_deg: float) -> float:
    """Return the score of the scan as images would show it at one pose beside the scan as they would show it at another.

    Both compared at one pose of the rig, in the same window of its axes: their pixels are the same directions.
    """
    both = here.weights * (there.weights > 0)
    return float(agreement(replace(here, seen=there.scan, weights=both), config, share, patch_deg).score)


def with_agreement(group: Sequence[Hypothesis], measured: Agreement) -> list[Hypothesis]:
    """Return the hypotheses (K) with their score and measures."""
    names = [f.name for f in fields(measured) if f.name != "score" and getattr(measured, f.name) is not None]
    columns = torch.stack([measured.score, *(getattr(measured, name) for name in names)], dim=1)
    return [
        replace(h, score=score, measures=dict(zip(names, values, strict=True)))
        for h, (score, *values) in zip(group, columns.tolist(), strict=True)
    ]
