"""How well scores separate, and how honest probabilities are: average precision, area under the ROC, expected calibration error."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


def average_precision(scores: Floats, positive: Flags, weights: Floats | None = None) -> float | None:
    """Return Σ (recall step · precision) over falling scores (N,), equal scores taken together; None without a positive.

    positive: (N,) bool. weights: (N,) >= 0, such as solid angles; None for equal ones.
    """
    ordered, true, false = _cumulated(scores, positive, weights)
    if len(ordered) == 0 or true[-1] == 0:
        return None
    precision = true / np.maximum(true + false, 1e-300)
    return float(np.sum(np.diff(true, prepend=0.0) * precision) / true[-1])


def area_under_roc(scores: Floats, positive: Flags) -> float | None:
    """Return the probability that a positive scores above a negative, ties counting half; None when one kind is missing."""
    ordered, true, false = _cumulated(scores, positive, None)
    if len(ordered) == 0 or true[-1] == 0 or false[-1] == 0:
        return None
    rate, fallout = np.append(0.0, true / true[-1]), np.append(0.0, false / false[-1])
    return float(np.sum(np.diff(fallout) * (rate[1:] + rate[:-1]) / 2))


def _cumulated(scores: Floats, positive: Flags, weights: Floats | None) -> tuple[Floats, Floats, Floats]:
    """Return the distinct scores, falling, with the weight of positives and of negatives at or above each."""
    order = np.argsort(-scores, kind="stable")
    falling = scores[order]
    weight = (np.ones(len(scores)) if weights is None else weights)[order]
    last_of_ties = np.append(np.diff(falling) != 0, True) if len(falling) else np.zeros(0, bool)
    true = np.cumsum(weight * positive[order])[last_of_ties]
    false = np.cumsum(weight * ~positive[order])[last_of_ties]
    return falling[last_of_ties], true, false


@dataclass(frozen=True)
class ReliabilityBin:
    """The answers whose probability lies in one bin: how many, their mean probability, and the share that was right."""

    lower: float
    upper: float
    count: int
    mean_probability: float
    share_right: float


def reliability_bins(probabilities: Floats, right: Flags, num_bins: int = 10) -> list[ReliabilityBin]:
    """Return the non-empty bins of equal width over 0..1."""
    number = np.clip((probabilities * num_bins).astype(int), 0, num_bins - 1)
    return [
        ReliabilityBin(
            k / num_bins,
            (k + 1) / num_bins,
            int((number == k).sum()),
            float(probabilities[number == k].mean()),
            float(right[number == k].mean()),
        )
        for k in range(num_bins)
        if (number == k).any()
    ]


def expected_calibration_error(probabilities: Floats, right: Flags, num_bins: int = 10) -> float | None:
    """Return the mean gap between probability and share right over bins of equal width, weighted by count; None without answers."""
    if len(probabilities) == 0:
        return None
    bins = reliability_bins(probabilities, right, num_bins)
    return sum(b.count * abs(b.mean_probability - b.share_right) for b in bins) / len(probabilities)
