"""The intersection tensor: every query patch against every patch of every synthetic view, by histogram intersection Λ.

Paper: §3.2. Everything the `paper` method's search needs is a reduction of this one tensor (docs/method.md).
"""

import torch
from torch import Tensor


def bin_major(histograms: Tensor) -> Tensor:
    """Return histograms (T, P, B) as (B, P T), contiguous: the layout in which one query bin reads one row."""
    return histograms.permute(2, 1, 0).flatten(1).contiguous()


def intersection_tensor(query: Tensor, views: Tensor, num_views: int) -> Tensor:
    """Return I (T, P, P'): Λ of query patch i (second axis) and view patch j (third axis), Λ(a, b) = Σ min(a, b).

    query: (P, B) normalised histograms. views: (B, P' T) from `bin_major`. Only the bins that a query patch
    occupies can contribute, about 12 of 512.
    """
    rows = []
    for histogram in query:
        occupied = histogram.nonzero()[:, 0]
        rows.append(torch.minimum(views[occupied], histogram[occupied, None]).sum(0))
    return torch.stack(rows).view(len(query), -1, num_views).permute(2, 0, 1)
