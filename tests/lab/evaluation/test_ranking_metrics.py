"""Average precision, area under the ROC and calibration error against twins that follow the definitions word by word."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoloc.lab.evaluation.metrics import (
    area_under_roc,
    average_precision,
    expected_calibration_error,
)

Samples = list[tuple[int, bool]]
samples = st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=1, max_size=25)


def _arrays(made: Samples) -> tuple[np.ndarray, np.ndarray]:
    return np.array([s / 6 for s, _ in made], np.float64), np.array([p for _, p in made], bool)


@given(samples)
def test_average_precision_is_the_mean_precision_at_the_positives(made: Samples) -> None:
    scores, positive = _arrays(made)
    if not positive.any():
        assert average_precision(scores, positive) is None
        return
    # At each positive: of all samples that score at least as high, the share of positives.
    precisions = [positive[scores >= s].mean() for s in scores[positive]]
    assert average_precision(scores, positive) == pytest.approx(np.mean(precisions))


@given(samples)
def test_the_area_is_the_chance_that_a_positive_beats_a_negative(made: Samples) -> None:
    scores, positive = _arrays(made)
    pairs = [float(p > n) + 0.5 * float(p == n) for p in scores[positive] for n in scores[~positive]]
    if not pairs:
        assert area_under_roc(scores, positive) is None
        return
    assert area_under_roc(scores, positive) == pytest.approx(np.mean(pairs))


@given(samples)
def test_calibration_error_sums_the_gaps_of_the_bins(made: Samples) -> None:
    scores, right = _arrays(made)
    total = 0.0
    for lower in range(10):
        inside = [(s, r) for s, r in zip(scores, right, strict=True) if min(int(s * 10), 9) == lower]
        if inside:
            total += abs(sum(s for s, _ in inside) - sum(r for _, r in inside)) / len(scores)
    assert expected_calibration_error(scores, right) == pytest.approx(total)


def test_weights_count_as_repetitions() -> None:
    scores, positive = np.array([0.9, 0.8, 0.7, 0.1]), np.array([True, False, True, False])
    weights = np.array([1, 3, 2, 5])
    repeated = average_precision(np.repeat(scores, weights), np.repeat(positive, weights))
    assert average_precision(scores, positive, weights.astype(np.float64)) == pytest.approx(repeated)
