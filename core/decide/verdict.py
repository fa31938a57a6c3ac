"""The verdict: from judged hypotheses to how sure each place is, and whether to say so."""

from collections.abc import Sequence
from dataclasses import dataclass

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.confidence import ConfidenceModel, error_radii, features_of, formal_radii, share_within
from panoloc.core.decide.hypotheses import Hypothesis, distinct, with_distinctness
from panoloc.core.options import Status


@dataclass(frozen=True)
class Verdict:
    """Hypotheses at different places, best first, the confidence of each, and what to say of the best one.

    together: how sure it is that the best, or one of its equals, is the right one.
    """

    places: list[Hypothesis]
    confidences: list[float]
    status: Status
    together: float


def verdict(hypotheses: Sequence[Hypothesis], model: ConfidenceModel, config: JudgeConfig) -> Verdict:
    """Judge the places of hypotheses, at least one, the best first."""
    places = distinct(hypotheses, config.place)
    equals = [h for h in places if _is_equal(h, places[0], config)]
    unequal = [h for h in places if all(h is not other for other in equals)]
    # Nothing is surer than its radius allows; of the other places, which are improbable anyhow, it is not worked out.
    formal = formal_radii(places[0])
    limit = share_within(*error_radii(formal, places[0].measures, model))
    # Would it be sure if the equals were not there? Otherwise nothing fits, and a wrong scan is not an ambiguous one.
    alone = min(model.probability(features_of(with_distinctness(places[0], unequal), 0.0, formal, config)), limit)
    if len(equals) > 1 and alone >= model.threshold and not places[0].is_held_back:
        shared = [alone / len(equals)] * len(equals)
        others = [_confidence(place, places, model, config) for place in unequal]
        return Verdict([*equals, *unequal], shared + _left_over(others, alone, shared[0]), "ambiguous", alone)
    best = min(_confidence(places[0], places, model, config, formal), limit)
    others = [_confidence(place, places, model, config) for place in places[1:]]
    status: Status = "localized" if best >= model.threshold else "not_localized"
    return Verdict(places, [best, *_left_over(others, best, best)], status, best)


def _is_equal(place: Hypothesis, best: Hypothesis, config: JudgeConfig) -> bool:
    """Tell whether a place fits as well as the best, as far as can be told: of places that look like each other less than of others."""
    behind, alike = best.score - place.score, place.likeness
    if place.is_same_view:
        return behind < config.same_view_ambiguous_share * best.score
    if alike is not None and place is not best:
        if alike < config.unlike_share * best.score:
            return False
        if alike >= config.alike_share * best.score:
            return behind < config.alike_ambiguous_share * best.score
    return behind < min(config.ambiguous_margin, config.ambiguous_share * best.score)


def _left_over(confidences: Sequence[float], together: float, most: float) -> list[float]:
    """Return confidences of places that come after the best ones: none above `most`, which those have, and no more in all than is left.

    Of each place less was measured than of the best, and only one of them is right.
    """
    capped = [min(confidence, most) for confidence in confidences]
    share = min(1.0, (1 - together) / max(sum(capped), 1e-12))
    return [share * confidence for confidence in capped]


def _confidence(
    place: Hypothesis,
    places: Sequence[Hypothesis],
    model: ConfidenceModel,
    config: JudgeConfig,
    formal: tuple[float, float] | None = None,
) -> float:
    """Return the probability that a place is the right one, against the best of the others. formal: its radii by the curvature of the loss,
    where they were worked out."""
    rival = max((h.score for h in places if h is not place), default=0.0)
    probability = model.probability(features_of(place, rival, formal, config))
    return min(probability, model.threshold / 2) if place.is_held_back else probability
