"""Confidence: a calibrated probability that a pose is within 0.3 m and 10 degrees, and the radius of its error.

The probability is a logistic function of what the judge measured and of the margin over the best other place; its coefficients were fitted
by `scripts/fit_confidence.py` on poses with known truth (docs/confidence.md says on which, and how it held on others).
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import torch

from core.hypotheses import Hypothesis

FEATURES = ("correlation", "patch_correlation", "mutual_information", "inlier_share", "log_coverage", "margin")


# Beyond this the runner-up says nothing more; without one (all candidates in one place) the margin is neither sign.
_MAX_MARGIN, _UNKNOWN_MARGIN = 0.5, 0.2


@dataclass(frozen=True)
class ConfidenceModel:
    """Logistic coefficients by feature, the threshold for `localized`, and the factor from formal to observed error radius."""

    intercept: float
    coefficients: Mapping[str, float]
    threshold: float
    position_factor: float
    orientation_factor: float

    def probability(self, features: Mapping[str, float]) -> float:
        """Return the probability, 0..1, for the features named in `FEATURES`."""
        logit = self.intercept + sum(self.coefficients[name] * features[name] for name in FEATURES)
        return 1 / (1 + math.exp(-max(-50.0, min(50.0, logit))))


def load_confidence_model() -> ConfidenceModel:
    """Read the fitted coefficients that ship with the package."""
    data = json.loads(resources.files("core").joinpath("data/confidence.json").read_text())
    return ConfidenceModel(
        data["intercept"], data["coefficients"], data["threshold"], data["position_factor"], data["orientation_factor"]
    )


def features_of(hypothesis: Hypothesis, best_elsewhere: float) -> dict[str, float]:
    """Return the signs of confidence of a hypothesis; `best_elsewhere`: the judge's score of the best candidate at
    another place, 0 where there is none."""
    measures = hypothesis.measures
    return {
        "correlation": measures["correlation"],
        "patch_correlation": measures["patch_correlation"],
        "mutual_information": measures["mutual_information"],
        "inlier_share": measures["inlier_share"],
        "log_coverage": math.log(max(measures["coverage"], 1e-3)),
        "margin": min(hypothesis.score - best_elsewhere, _MAX_MARGIN) if best_elsewhere > 0 else _UNKNOWN_MARGIN,
    }


def error_radii(hypothesis: Hypothesis, model: ConfidenceModel) -> tuple[float | None, float | None]:
    """Return 68 % radii of position (metres) and orientation (degrees) from the curvature of the loss.

    The formal covariance treats residuals as independent; neighbouring pixels are not, so the factors of the model, fitted
    on poses with known truth, bring it to what is observed. None where a method gives no curvature.
    """
    if hypothesis.hessian is None:
        return None, None
    hessian = hypothesis.hessian.double().cpu()
    covariance = torch.linalg.pinv(hessian + 1e-9 * torch.eye(6, dtype=torch.float64)) * hypothesis.residual_scale**2
    diagonal = torch.diagonal(covariance).clamp_min(0)
    position = math.sqrt(float(diagonal[3:].sum())) * model.position_factor
    orientation = math.degrees(math.sqrt(float(diagonal[:3].sum()))) * model.orientation_factor
    return position, min(orientation, 180.0)
