"""The verdict: from judged hypotheses to how sure each place is, and whether to say so."""

from collections.abc import Sequence
from dataclasses import dataclass

from core.config import JudgeConfig
from core.judge.confidence import ConfidenceModel, features_of
from core.judge.hypotheses import Hypothesis, distinct
from core.options import Status


@dataclass(frozen=True)
class Verdict:
    """Hypotheses at different places, best first, the confidence of each, and what to say of the best one."""

    places: list[Hypothesis]
    confidences: list[float]
    status: Status


def verdict(hypotheses: Sequence[Hypothesis], model: ConfidenceModel, config: JudgeConfig) -> Verdict:
    """Judge the places of hypotheses that are sorted by falling score, at least one."""
    places = distinct(hypotheses, config.place)
    equals = [h for h in places if _is_equal(h, places[0], config)]
    # Would it be sure if the equals were not there? Otherwise nothing fits, and a wrong scan is not an ambiguous one.
    alone = model.probability(features_of(places[0], 0.0, config))
    if len(equals) > 1 and alone >= model.threshold and not places[0].is_held_back:
        shared = [alone / len(equals)] * len(equals)
        others = [_confidence(place, places, model, config) for place in places if all(place is not h for h in equals)]
        return Verdict(places, shared + others, "ambiguous")
    confidences = [_confidence(place, places, model, config) for place in places]
    return Verdict(places, confidences, "localized" if confidences[0] >= model.threshold else "not_localized")


def _is_equal(place: Hypothesis, best: Hypothesis, config: JudgeConfig) -> bool:
    """Tell whether a place fits as well as the best, as far as can be told: of places that look like each other less than of others."""
    behind, alike = best.score - place.score, place.likeness
    if alike is not None and place is not best:
        if alike < config.unlike_share * best.score:
            return False
        if alike >= config.alike_share * best.score:
            return behind < config.alike_ambiguous_share * best.score
    return behind < min(config.ambiguous_margin, config.ambiguous_share * best.score)


def _confidence(place: Hypothesis, places: Sequence[Hypothesis], model: ConfidenceModel, config: JudgeConfig) -> float:
    """Return the probability that a place is the right one, against the best of the others."""
    rival = max((h.score for h in places if h is not place), default=0.0)
    probability = model.probability(features_of(place, rival, config))
    return min(probability, model.threshold / 2) if place.is_held_back else probability
