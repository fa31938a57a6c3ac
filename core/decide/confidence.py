"""Confidence: a calibrated probability that a pose is within 0.3 m and 10 degrees, and the radius of its error.

The probability is a logistic function of what the judge measured and of the margin over the best other place; its coefficients were fitted
by `panoloc evaluate fit` on poses with known truth (docs/confidence.md says on which, and how it held on others).
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.hypotheses import Hypothesis

RIGHT_M, RIGHT_DEG = 0.3, 10.0  # nearer than both a pose is right
_HELD = 0.68  # of the poses are within their radii
_USUALLY_APART = 7.0  # times the formal radius, halves of pictures whose pose is right; half of them are farther apart
FEATURES = ("patch_correlation", "relative_margin", "distinctness", "halves", "sharpness", "lines")


@dataclass(frozen=True)
class RadiusModel:
    """How large errors are: a product of powers of what the curvature of the loss says, of how far apart halves of the picture end, and of
    the share of the sphere that was compared."""

    log_factor: float
    formal_power: float
    halves_power: float
    coverage_power: float  # by how much errors fall with it

    def radius(self, formal: float, halves_apart: float | None, coverage: float) -> float:
        """Return the 68 % radius, in the unit of the formal one; halves_apart: in that unit, None where nobody asked."""
        by_curvature, by_halves, by_coverage = radius_signs(formal, halves_apart, coverage)
        power = self.formal_power * by_curvature + self.halves_power * by_halves + self.coverage_power * by_coverage
        return math.exp(self.log_factor + power)


def radius_signs(formal: float, halves_apart: float | None, coverage: float) -> tuple[float, float, float]:
    """Return the logarithms that a `RadiusModel` weighs: of the formal radius and of how far halves end apart, both in metres or both in
    degrees, and of one over the coverage, 0..1."""
    formal = max(formal, 1e-9)
    # Halves that meet nearer than curvature allows do so by chance.
    apart = _USUALLY_APART * formal if halves_apart is None else max(halves_apart, formal)
    return math.log(formal), math.log(apart), -math.log(max(coverage, 1e-3))


@dataclass(frozen=True)
class ConfidenceModel:
    """Logistic coefficients by feature, the threshold for `localized`, and the error radii of position (m) and orientation (degrees)."""

    intercept: float
    coefficients: Mapping[str, float]
    threshold: float
    position_radius: RadiusModel
    orientation_radius: RadiusModel

    def probability(self, features: Mapping[str, float]) -> float:
        """Return the probability, 0..1, for the features named in `FEATURES`."""
        logit = self.intercept + sum(self.coefficients[name] * features[name] for name in FEATURES)
        return 1 / (1 + math.exp(-max(-50.0, min(50.0, logit))))


def load_confidence_model() -> ConfidenceModel:
    """Read the fitted coefficients that ship with the package."""
    data = json.loads(resources.files("panoloc.core.decide").joinpath("confidence.json").read_text())
    return ConfidenceModel(
        data["intercept"],
        data["coefficients"],
        data["threshold"],
        RadiusModel(**data["position_radius"]),
        RadiusModel(**data["orientation_radius"]),
    )


def features_of(
    hypothesis: Hypothesis, best_elsewhere: float, formal: tuple[float, float] | None, config: JudgeConfig
) -> dict[str, float]:
    """Return the signs of confidence of a hypothesis.

    best_elsewhere: the judge's score of the best candidate at another place, 0 where there is none. formal: its `formal_radii`, None where
    nobody asked.
    """
    measures, score = hypothesis.measures, hypothesis.score
    halves, sharpness = config.unknown_halves, config.unknown_sharpness
    if "halves_apart_m" in measures:
        apart = math.hypot(measures["halves_apart_m"] / RIGHT_M, measures["halves_apart_deg"] / RIGHT_DEG)
        halves = _times_nearer(apart, config.halves_range)
    if formal is not None:
        sharpness = _times_nearer(formal[1] / RIGHT_DEG, config.sharpness_range)
    return {
        "patch_correlation": measures["patch_correlation"],
        "relative_margin": 1 - best_elsewhere / max(score, best_elsewhere)
        if best_elsewhere > 0
        else config.unknown_relative_margin,
        "distinctness": measures.get("distinctness", config.unknown_distinctness),
        "halves": halves,
        "sharpness": sharpness,
        "lines": measures.get("lines", config.unknown_lines),
    }


def _times_nearer(share: float, limits: tuple[float, float]) -> float:
    """Return the logarithm of how many times nearer than what is right something is that is a `share` of that apart."""
    lowest, highest = limits
    return min(max(-math.log(max(share, 1e-9)), lowest), highest)


def formal_radii(hypothesis: Hypothesis) -> tuple[float, float] | None:
    """Return the radii of position (metres) and orientation (degrees) that the curvature of the loss alone would give; None without it.

    They treat residuals as independent, which those of neighbouring pixels are not, nor those of what changed or stands in another light.
    """
    if hypothesis.hessian is None:
        return None
    hessian = hypothesis.hessian.double().cpu()
    covariance = torch.linalg.pinv(hessian + 1e-9 * torch.eye(6, dtype=torch.float64)) * hypothesis.residual_scale**2
    diagonal = torch.diagonal(covariance).clamp_min(0)
    return math.sqrt(float(diagonal[3:].sum())), math.degrees(math.sqrt(float(diagonal[:3].sum())))


def error_radii(
    formal: tuple[float, float] | None, measures: Mapping[str, float], model: ConfidenceModel
) -> tuple[float | None, float | None]:
    """Return 68 % radii of position (metres) and orientation (degrees) from the formal ones and the judge's measures.

    How both go together was fitted on poses with known truth. None where a method gives no curvature.
    """
    if formal is None:
        return None, None
    coverage = measures["coverage"]
    position = model.position_radius.radius(formal[0], measures.get("halves_apart_m"), coverage)
    return position, min(model.orientation_radius.radius(formal[1], measures.get("halves_apart_deg"), coverage), 180.0)


def share_within(position_m: float | None, orientation_deg: float | None) -> float:
    """Return the share of poses with these 68 % radii that are nearer to the truth than what is right, errors being normal in the plane.

    Nothing is surer to be right than its radius allows. 1 where a radius is not known.
    """
    known = ((RIGHT_M, position_m), (RIGHT_DEG, orientation_deg))
    shares = [1 - (1 - _HELD) ** ((limit / radius) ** 2) for limit, radius in known if radius]
    return min(shares, default=1.0)
