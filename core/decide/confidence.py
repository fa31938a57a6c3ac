"""Confidence: a calibrated probability that a pose is within 0.3 m and 10 degrees, and the radius of its error.

The probability is a logistic function of what was measured at the pose and of how far it is ahead of other places; none of its features may
count against a pose. Its coefficients were fitted by `panoloc evaluate fit` on poses with known truth (docs/confidence.md says on which,
and how it held on others).
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import torch

from panoloc.core.config import DISTANCES
from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy, Hypothesis
from panoloc.core.refine.refinement import NOWHERE

_GOOD_THICKNESS_M = 0.004  # of surfaces of a scan whose stations fit each other
_FAR_AHEAD = 0.5  # of the score; places that are farther behind say nothing more
# Of halves and lines that were not measured.
_UNKNOWN = 0.8
FEATURES = (
    "agreement",
    "margin",
    "halves",
    "lines",
)


@dataclass(frozen=True)
class RadiusModel:
    """How large errors are: a product of powers of what the curvature of the loss says, of how far apart halves of the images end, of the
    share of the sphere that was compared, and of how thick the surfaces of the scan are."""

    log_factor: float
    formal_power: float
    halves_power: float
    coverage_power: float  # by how much errors fall with it
    thickness_power: float

    def radius(self, formal: float, halves_apart: float, coverage: float, thickness_m: float) -> float:
        """Return the 68 % radius, in the unit of the formal one, which is that of halves_apart."""
        powers = self.formal_power, self.halves_power, self.coverage_power, self.thickness_power
        signs = radius_signs(formal, halves_apart, coverage, thickness_m)
        return math.exp(self.log_factor + sum(power * sign for power, sign in zip(powers, signs, strict=True)))


def radius_signs(
    formal: float, halves_apart: float, coverage: float, thickness_m: float
) -> tuple[float, float, float, float]:
    """Return the logarithms that a `RadiusModel` weighs: of the formal radius and of how far halves end apart, both in metres or both in
    degrees, of one over the coverage, 0..1, and of how thick surfaces are, over that of a good scan."""
    formal = max(formal, 1e-9)
    # Halves that meet nearer than curvature allows do so by chance.
    apart = max(halves_apart, formal)
    thick = math.log(max(thickness_m / _GOOD_THICKNESS_M, 1.0))
    return math.log(formal), math.log(apart), -math.log(max(coverage, 1e-3)), thick


@dataclass(frozen=True)
class ConfidenceModel:
    """Logistic coefficients by feature, how much scores tell between aliases, the threshold for `localized`, the error radii of position
    (m) and orientation (degrees), and the share of the poses that it was fitted to which were right."""

    intercept: float
    coefficients: Mapping[str, float]
    alias_power: float
    threshold: float
    position_radius: RadiusModel
    orientation_radius: RadiusModel
    share_right: float

    def probability(self, features: Mapping[str, float]) -> float:
        """Return the probability, 0..1, for the features named in `FEATURES`."""
        logit = self.intercept + sum(self.coefficients[name] * features[name] for name in FEATURES)
        return 1 / (1 + math.exp(-max(-50.0, min(50.0, logit))))

    def confidence(self, best: Hypothesis, rivals: Sequence[Hypothesis]) -> float:
        """Return how probably a pose is right against its rivals: that it fits, and that it is the one of its aliases that was taken.

        Between places that look the same only the scores tell: their probabilities go with powers of these.
        """
        odds = sum(self.alias_odds(best, rivals)) + best.measures.get("focal_odds", 0.0)
        return self.probability(features_of(best, rivals)) / (1 + odds)

    def alias_odds(self, best: Hypothesis, rivals: Sequence[Hypothesis]) -> list[float]:
        """Return how probable each alias among the rivals is, as a share of how probable the best is."""
        return [math.exp(-self.alias_power * margin) for margin in alias_margins(best, rivals)]

    def among(self, confidence: float, prior: float) -> float:
        """Return a confidence where the right place is in one of the maps that were searched with probability `prior` alone: before
        anything is known of a pose it is then right more rarely, and its odds change by that (Bayes)."""
        odds = prior * (1 - self.share_right) / (1 - prior * self.share_right)
        return confidence * odds / (1 - confidence + confidence * odds)

    def accuracy(self, hypothesis: Hypothesis, noise: Accuracy = NO_NOISE) -> Accuracy:
        """Return the radii of a pose. noise: what adds to the errors of the pose itself."""
        formal, measures = formal_radii(hypothesis), hypothesis.measures
        if formal is None:
            return Accuracy(None, None)
        coverage, thickness_m = measures["coverage"], measures.get("thickness_m", 0.0)
        position_m = self.position_radius.radius(formal[0], measures.get("halves_apart_m", 0.0), coverage, thickness_m)
        orientation_deg = self.orientation_radius.radius(
            formal[1], measures.get("halves_apart_deg", 0.0), coverage, thickness_m
        )
        return Accuracy(position_m, min(orientation_deg, 180.0)).with_noise(noise)


def load_confidence_model() -> ConfidenceModel:
    """Read the fitted coefficients that ship with the package."""
    data = json.loads(resources.files("panoloc.core.decide").joinpath("confidence.json").read_text())
    return ConfidenceModel(
        data["intercept"],
        data["coefficients"],
        data["alias_power"],
        data["threshold"],
        RadiusModel(**data["position_radius"]),
        RadiusModel(**data["orientation_radius"]),
        data["fitted_on"]["right"] / data["fitted_on"]["rows"],
    )


def features_of(best: Hypothesis, rivals: Sequence[Hypothesis]) -> dict[str, float]:
    """Return the features of a pose against its rivals at other places."""
    measures, right = best.measures, DISTANCES.right
    halves = _UNKNOWN
    if "halves_apart_m" in measures:
        share = math.hypot(
            measures["halves_apart_m"] / right.distance_m, measures["halves_apart_deg"] / right.angle_deg
        )
        halves = -math.log(max(share, 1e-3))
    return {
        "agreement": measures["patch_correlation"],
        "margin": _margin(best, [rival for rival in rivals if not rival.is_alias]),
        "halves": halves,
        "lines": measures.get("lines", _UNKNOWN),
    }


def alias_margins(best: Hypothesis, rivals: Sequence[Hypothesis]) -> tuple[float, ...]:
    """Return by how much a score is over that of each of its aliases, as a share of it."""
    return tuple(1 - rival.score / max(best.score, 1e-6) for rival in rivals if rival.is_alias)


def _margin(best: Hypothesis, rivals: Sequence[Hypothesis]) -> float:
    """Return by how much a score is over that of the best rival, as a share of it, within `_FAR_AHEAD` either way."""
    rival, most = max((each.score for each in rivals), default=0.0), best.measures.get("most_margin", _FAR_AHEAD)
    return max(-_FAR_AHEAD, min(most, 1 - rival / max(best.score, 1e-6)))


def formal_radii(hypothesis: Hypothesis) -> tuple[float, float] | None:
    """Return the radii of position (metres) and orientation (degrees) that the curvature of the loss alone would give; None without it.

    They treat residuals as independent, which those of neighbouring pixels are not, nor those of what changed or stands in another light.
    """
    if hypothesis.hessian is None:
        return None
    if float(hypothesis.hessian.diagonal().sum()) <= 0:
        return NOWHERE[0], math.degrees(NOWHERE[1])  # nothing of the images agrees, which is no agreement
    hessian = hypothesis.hessian
    covariance = torch.linalg.pinv(hessian + 1e-9 * torch.eye(6, dtype=torch.float64)) * hypothesis.residual_scale**2
    diagonal = torch.diagonal(covariance).clamp_min(0)
    return math.sqrt(float(diagonal[3:].sum())), math.degrees(math.sqrt(float(diagonal[:3].sum())))
