"""The judge's measures as loops over pixels and patches, from their definitions."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def covariances(first: Array, second: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return the weighted covariance and both variances (C,) of colours (S, C) with weights (S,)."""
    share = weights / weights.sum()
    moments = np.zeros((3, first.shape[1]))
    middle_first, middle_second = share @ first, share @ second
    for one, other, part in zip(first, second, share, strict=True):
        a, b = one - middle_first, other - middle_second
        moments += part * np.stack((a * b, a * a, b * b))
    return moments[0], moments[1], moments[2]


def correlation(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the mean over channels of the correlation of all pixels, with 1e-4 for the variance of noise."""
    both, one, other = covariances(scan, panorama, weights)
    return float(np.mean(both / np.sqrt((one + 1e-4) * (other + 1e-4))))


def patch_correlation(scan: Array, panorama: Array, weights: Array, height: int, rows: int) -> float:
    """Return the mean over patches of the correlation of all their channels together, by the weight that each patch has.

    height: of the image; rows: of patches. 1e-3 stands for the variance of noise.
    """
    side, width = height // rows, 2 * height
    total = 0.0
    for top in range(0, height, side):
        for left in range(0, width, side):
            inside = [row * width + column for row in range(top, top + side) for column in range(left, left + side)]
            mass = weights[inside].sum()
            if mass > 0:
                both, one, other = (part.sum() for part in covariances(scan[inside], panorama[inside], weights[inside]))
                total += mass * both / math.sqrt((one + 1e-3) * (other + 1e-3))
    return float(total / weights.sum())


def mutual_information(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the mutual information in nats of the brightness of both, each in 16 steps."""
    joint = np.zeros((16, 16))
    for one, other, weight in zip(scan.mean(1), panorama.mean(1), weights / weights.sum(), strict=True):
        joint[min(int(one * 16), 15), min(int(other * 16), 15)] += weight
    information = 0.0
    for a, b in np.argwhere(joint > 0):
        information += joint[a, b] * math.log(joint[a, b] / (joint[a].sum() * joint[:, b].sum()))
    return information


def inlier_share(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the share of pixels that fit; one whose colours are 0.15 apart counts half."""
    fits = [1 / (1 + ((a - b) @ (a - b)) / 0.15**2) for a, b in zip(scan, panorama, strict=True)]
    return float(weights @ np.array(fits) / weights.sum())
