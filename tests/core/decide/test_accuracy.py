"""How far off a pose may be, and how sure that allows it to be right."""

import numpy as np
import pytest

from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy


@pytest.mark.parametrize(
    ("position_m", "orientation_deg", "share"),
    [
        (None, None, 1.0),
        (0.0, 0.0, 1.0),
        (0.3, 1.0, 0.68),  # as far as a right pose may be off
        (0.1, 10.0, 0.68),
        (0.15, None, 1 - 0.32**4),
        (1.2, 0.1, 1 - 0.32 ** (1 / 16)),
    ],
)
def test_nothing_is_surer_to_be_right_than_its_radius_allows(
    position_m: float | None, orientation_deg: float | None, share: float
) -> None:
    assert Accuracy(position_m, orientation_deg).share_right == pytest.approx(share)


@pytest.mark.parametrize("radius_m", [0.2, 0.4, 0.7])
def test_errors_that_are_normal_in_the_plane_are_right_as_often_as_their_radius_says(radius_m: float) -> None:
    off = np.linalg.norm(np.random.default_rng(0).normal(size=(200_000, 2)), axis=1)
    off *= radius_m / np.quantile(off, 0.68)
    assert Accuracy(radius_m, 0.1).share_right == pytest.approx(np.mean(off <= 0.3), abs=0.005)


def test_noise_adds_in_quadrature_and_no_turn_is_more_than_half_a_one() -> None:
    found = Accuracy(0.03, 4.0).with_noise(Accuracy(0.04, 3.0))
    assert (found.position_m, found.orientation_deg) == pytest.approx((0.05, 5.0))
    assert Accuracy(0.03, 170.0).with_noise(Accuracy(0.0, 90.0)).orientation_deg == 180.0
    assert Accuracy(0.03, 4.0).with_noise(NO_NOISE) == Accuracy(0.03, 4.0)
    assert Accuracy(None, None).with_noise(Accuracy(0.04, 3.0)) == Accuracy(None, None)
