"""1-D optimal transport of colours by sorting, without look-up tables."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rank_of(values: Array, weights: Array) -> Array:
    """Return for each value (N,) the weighted share of values that are smaller, ties counted half."""
    total = weights.sum()
    return np.array([(weights[values < value].sum() + weights[values == value].sum() / 2) / total for value in values])


def matched_by_sorting(source: Array, target: Array) -> Array:
    """Return the optimal transport (N,) of N equally heavy source values to N equally heavy target values: k-th to k-th."""
    matched = np.empty_like(source)
    matched[np.argsort(source, kind="stable")] = np.sort(target)
    return matched


def transport_cost(source: Array, moved: Array) -> float:
    """Return the mean squared distance that the values were moved."""
    return float(np.mean((source - moved) ** 2))
