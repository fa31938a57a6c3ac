"""How well each photo of a session agrees with the pose that was found for all of them.

A photo whose pose among the others is wrong agrees nowhere. One that shows what has changed agrees in parts, though its correlation over
all pixels may be nothing: one new sofa is enough. One that shows a plain wall, or a thing held before the lens, tells nothing at all.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.patch_correlation import correlation, correlation_in_patches, in_patches
from panoloc.core.render.comparison import Comparison


@dataclass(frozen=True)
class PhotoAgreement:
    """What a photo shows of the scan, against the scan seen from its pose.

    correlation: of all pixels, −1..1. agreeing_share: of what it shows, in patches that agree, 0..1. contrast: standard deviation of
    its colours inside patches.
    """

    correlation: float
    agreeing_share: float
    contrast: float

    def contradicts(self, config: JudgeConfig) -> bool:
        """Tell whether the photo cannot be of where it is said to be."""
        agrees = self.correlation >= config.contradiction or self.agreeing_share >= config.contradicting_patches
        return not agrees and self.contrast >= config.telling_contrast


def agreement_by_photo(comparison: Comparison | None, count: int, config: JudgeConfig) -> list[PhotoAgreement | None]:
    """Return how each of `count` photos agrees with the scan at the one pose compared; None where nothing is in view."""
    if comparison is None:
        return [None] * count
    found = []
    for number in range(count):
        weights = comparison.weights * (comparison.image == number)
        found.append(_agreement(comparison, weights, config) if float(weights.sum()) > 0 else None)
    return found


def _agreement(comparison: Comparison, weights: Tensor, config: JudgeConfig) -> PhotoAgreement:
    """Measure one photo, whose pixels alone have weights (1, S)."""
    shares = weights / weights.sum()
    scan, photo, window = comparison.scan, comparison.seen, comparison.views.window
    sides = torch.cat((scan, photo, shares[..., None]), dim=-1)
    patches = in_patches(sides, window.height, window.rows // config.photo_patch_rows)
    inside, mass = correlation_in_patches(patches, config.min_patch_variance)
    within = patches[..., 6:] / mass.clamp_min(1e-12)[..., None, None]
    colors = patches[..., 3:6]
    spread = (within * (colors - (within * colors).sum(-2, keepdim=True)).square()).sum((-2, -1)).sqrt()
    return PhotoAgreement(
        float(correlation(scan, photo, shares, config.min_variance).mean()),
        float(((inside >= config.agreement) * mass).sum()),
        float((spread * mass).sum()),
    )
