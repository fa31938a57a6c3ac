"""Colours of the panorama matched to those of the whole cloud. Paper: §3.1 and supplement, table 1 (CDF matching)."""

import numpy as np
import torch
from torch import Tensor

from panoloc.core.features.equalization import equalization_tables, equalize, quantized


def transport(source: Tensor, weights: Tensor, target: Tensor) -> Tensor:
    """Match the colour distribution of `source` (P, 3) to that of `target` (N, 3), per channel, by 1-D optimal transport.

    Values in 0..1; weights: (P,), of the source. Returns (P, 3).
    """
    rank = equalize(source[None], weights[None])[0].T.cpu()
    tables = equalization_tables(target[None], torch.ones_like(target[None, :, 0]))[0].cpu()
    matched = []
    for ranks, table, levels in zip(rank, tables, quantized(target).T.cpu(), strict=True):
        # Levels that no target point has would make the inverse flat; only occupied levels carry the map.
        occupied = levels.unique()
        matched.append(np.interp(ranks, table[occupied], occupied / 255))
    return torch.from_numpy(np.stack(matched, axis=-1)).float().to(source.device)
