"""Joint colour histograms of patches. Paper: §3.2 (B bins per channel per patch)."""

from collections.abc import Sequence

from torch import Tensor


def soft_histograms(colorings: Sequence[Tensor], weights: Tensor, patch: Tensor, num_patches: int, bins: int) -> Tensor:
    """Return normalised joint histograms (V, P, K bins³), each pixel shared trilinearly between the bins around it.

    colorings: K colours (V, S, 3) in 0..1 of the same pixels, whose histograms lie side by side; weights: (V, S) >= 0, zero where missing;
    patch: (V, S) the patch of each pixel.
    A patch without a valid pixel has the zero histogram. Deviation: a colour at the edge of a bin jumps with the least noise or change of
    light when bins are hard; the right start was first in 0.44 of the hardest shared queries with hard bins, in 0.62 with shared ones.
    """
    # Each coloring adds to its own part of the same memory: joining histograms afterwards takes as long as making them.
    histograms = weights.new_zeros((len(weights), num_patches, len(colorings), bins**3))
    flat = histograms.view(len(weights), -1)
    for number, color in enumerate(colorings):
        position = (color * bins - 0.5).clamp_(0, bins - 1)
        low = position.floor().clamp_(0, bins - 2)
        shares = position.sub_(low).unbind(-1)
        red, green, blue = low.long().unbind(-1)
        first = (patch * len(colorings) + number) * bins**3 + (red * bins + green) * bins + blue
        corners = [(first, weights)]
        for share, step in zip(shares, (bins * bins, bins, 1), strict=True):
            corners = [
                corner for at, part in corners for corner in ((at, part * (1 - share)), (at + step, part * share))
            ]
        for at, part in corners:
            flat.scatter_add_(1, at, part)
    histograms /= histograms.sum(-1, keepdim=True).clamp_min(1e-12)
    return histograms.flatten(2)
