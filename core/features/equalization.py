"""Canonical colours: what remains of an image when its light is taken out.

The paper matches the colours of the query to those of the whole cloud by 1-D optimal transport per channel (§3.1). On a flat of
several rooms that repaints one room in the average colours of all. Here both sides, the panorama and every synthetic view, are
transported to the same target: the uniform distribution, per channel. Any monotone change of a channel (exposure, gamma, white balance,
tone curve) then leaves no trace, each view's transport depends on what that view sees alone, and all of it is done at registration.

Deviation: measured on the shared cases (docs/experiments.md), the right pose is among the first 32 of 1.4 million in 100 % of the
queries with equalised colours, 83 % with raw colours, 91 % with gains; one model replaces four competing ones.
"""

import torch
from torch import Tensor

from panoloc.core.kernels.library import call, has_kernels_for

_BRIGHTEST = torch.iinfo(torch.uint8).max  # files have colours of 8 bits


def equalize(color: Tensor, weights: Tensor) -> Tensor:
    """Transport each channel of each image to the uniform distribution.

    color: (B, P, 3) float32 in 0..1; weights: (B, P) >= 0, the solid angle of each pixel, zero where it is missing.
    Returns (B, P, 3) float32 in 0..1; the value is the weighted share of pixels that are darker, ties counted half.
    """
    return apply_tables(color, equalization_tables(color, weights))


def equalization_tables(color: Tensor, weights: Tensor) -> Tensor:
    """Return the look-up tables (B, 3, 256) float32 that `equalize` applies."""
    if has_kernels_for(color):
        tables = color.new_empty((len(color), 3, _BRIGHTEST + 1))
        call("equalization_tables", color, weights.expand(color.shape[:2]), *color.shape[:2], tables)
        return tables
    histogram = torch.zeros((len(color), 3, _BRIGHTEST + 1), device=color.device)
    histogram.scatter_add_(2, quantized(color).transpose(1, 2), weights[:, None].expand(-1, 3, -1).contiguous())
    cumulative = histogram.cumsum(-1)
    return (cumulative - histogram / 2) / cumulative[..., -1:].clamp_min(1e-12)


def apply_tables(color: Tensor, tables: Tensor) -> Tensor:
    """Return colours (B, P, 3) looked up in tables (B, 3, 256)."""
    if has_kernels_for(color):
        found = color.new_empty(color.shape)
        call("apply_tables", color, tables, *color.shape[:2], found)
        return found
    level = quantized(color).transpose(1, 2)
    return torch.gather(tables, 2, level).transpose(1, 2)


def quantized(color: Tensor) -> Tensor:
    """Return the level of 256, int64, that each colour in 0..1 is nearest to."""
    return (color * _BRIGHTEST).round().long().clamp_(0, _BRIGHTEST)
