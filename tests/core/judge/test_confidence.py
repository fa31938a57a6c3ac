"""Confidence and error radii: what may move them, and which way."""

import pytest
import torch

from core.judge.confidence import (
    FEATURES,
    ConfidenceModel,
    RadiusModel,
    error_radii,
    formal_radii,
    load_confidence_model,
)
from core.judge.hypotheses import Hypothesis


def test_confidence_never_falls_with_a_sign_of_agreement_and_grows_with_most() -> None:
    model = load_confidence_model()
    base = dict.fromkeys(FEATURES, 0.2)
    grown = [model.probability(base | {name: 0.4}) - model.probability(base) for name in FEATURES]
    assert min(grown) >= 0
    assert sum(growth > 0 for growth in grown) >= 4
    assert 0 <= model.probability(dict.fromkeys(FEATURES, -1e6)) < 1e-6
    assert 1 - 1e-6 < model.probability(dict.fromkeys(FEATURES, 1e6)) <= 1


def test_a_sharper_loss_means_a_smaller_error_radius() -> None:
    model = ConfidenceModel(0.0, {}, 0.5, RadiusModel(0.0, 1.0, 0.0), RadiusModel(0.0, 1.0, 0.0))
    base = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), hessian=torch.eye(6) * 100, residual_scale=0.1)
    sharp = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), hessian=torch.eye(6) * 400, residual_scale=0.1)
    wide, narrow = (error_radii(formal_radii(one), {"patch_correlation": 0.5}, model) for one in (base, sharp))
    assert wide[0] is not None
    assert narrow[0] is not None
    assert narrow[0] == pytest.approx(wide[0] / 2, rel=1e-3)


def test_less_agreement_never_means_a_smaller_error_radius() -> None:
    model = load_confidence_model()
    alike, unlike = (error_radii((0.01, 0.1), {"patch_correlation": value}, model) for value in (0.9, 0.3))
    assert alike[0] is not None
    assert unlike[0] is not None
    assert unlike[0] >= alike[0]


def test_without_a_curvature_there_is_no_error_radius() -> None:
    hypothesis = Hypothesis(0, 0, torch.eye(3), torch.zeros(3))
    assert error_radii(formal_radii(hypothesis), {}, load_confidence_model()) == (None, None)
