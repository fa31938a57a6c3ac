"""Correlation of two pictures, of all their pixels and inside patches: what no gain, offset or contrast moves."""

import torch
from torch import Tensor

from panoloc.core.geometry.sphere_window import SphereWindow


def correlation(first: Tensor, second: Tensor, share: Tensor, floor: float, joint_channels: bool = False) -> Tensor:
    """Return weighted correlations (..., C), or (..., 1) over all channels together, of (..., S, C) with shares (..., S).

    `floor` is a variance below which contrast is noise.
    """
    weight = share[..., None]
    first = first - (weight * first).sum(-2, keepdim=True)
    second = second - (weight * second).sum(-2, keepdim=True)
    covariance = (weight * first * second).sum(-2)
    variances = (weight * first.square()).sum(-2), (weight * second.square()).sum(-2)
    if joint_channels:
        covariance = covariance.sum(-1, keepdim=True)
        variances = variances[0].sum(-1, keepdim=True), variances[1].sum(-1, keepdim=True)
    return covariance / ((variances[0] + floor) * (variances[1] + floor)).sqrt()


def correlation_in_patches(patches: Tensor, floor: float) -> tuple[Tensor, Tensor]:
    """Return the correlation (K, P) inside each of the patches (K, P, S, 7), of colours, colours and shares, and their shares (K, P)."""
    weight = patches[..., 6]
    mass = weight.sum(-1)
    share = weight / mass.clamp_min(1e-12)[..., None]
    inside = correlation(patches[..., :3], patches[..., 3:6], share, floor, joint_channels=True)
    return inside[..., 0], mass


def in_patches(values: Tensor, height: int, side: int) -> Tensor:
    """Reorder (K, H W, C) to (K, patches, pixels of a patch, C); patches are `side` pixels high and wide."""
    batch, _, channels = values.shape
    grid = values.view(batch, height // side, side, -1, side, channels)
    return grid.transpose(2, 3).reshape(batch, -1, side * side, channels)


def in_shifted_patches(values: Tensor, window: SphereWindow, side: int) -> Tensor:
    """Reorder pixels (K, H W, C) of a window as `in_patches` does, into patches that begin in the middle of those."""
    half = side // 2
    image = values.view(len(values), window.height, window.width, -1)
    padded = torch.nn.functional.pad(image, (0, 0, half, side - half, half, side - half))
    return in_patches(padded.flatten(1, 2), window.height + side, side)
