"""The verdict: from judged hypotheses to how sure each place is, and whether to say so.

One model decides: a pose is localized where it is probably right; ambiguous where it would be if its rivals were not there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.accuracy import NO_NOISE, Accuracy
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import Hypothesis, distinct
from panoloc.core.options import Status


@dataclass(frozen=True)
class Verdict:
    """Hypotheses at different places, best first, the confidence of each, what to say of the best one, and its radii.

    together: how sure it is that the best, or one of its equals, is the right one. num_equals: how many places come first together.
    """

    places: list[Hypothesis]
    confidences: list[float]
    status: Status
    together: float
    accuracy: Accuracy
    num_equals: int = 1


def verdict(
    hypotheses: Sequence[Hypothesis], model: ConfidenceModel, config: JudgeConfig, noise: Accuracy = NO_NOISE
) -> Verdict:
    """Judge the places of hypotheses, at least one, the best first. noise: what adds to the errors of the pose itself."""
    places = distinct(hypotheses, config.place)
    best, *rivals = places
    accuracy = model.accuracy(best, noise)

    def confidence_against(some: Sequence[Hypothesis]) -> float:
        """Return how sure the best is if these were its only rivals."""
        most = model.threshold / 2 if best.beyond_limits else accuracy.share_right
        return min(model.confidence(best, some), most)

    alone, against_all = confidence_against([]), confidence_against(rivals)
    if against_all < model.threshold <= alone:
        equals = [rival for rival in rivals if confidence_against([rival]) < model.threshold]
        unequal = [rival for rival in rivals if all(rival is not other for other in equals)]
        if equals:
            shared = [alone / (len(equals) + 1)] * (len(equals) + 1)
            confidences = shared + _left_over(unequal, 1 - alone, shared[0])
            return Verdict([best, *equals, *unequal], confidences, "ambiguous", alone, accuracy, len(shared))
    status: Status = "localized" if against_all >= model.threshold else "not_localized"
    confidences = [against_all, *_left_over(rivals, 1 - against_all, against_all)]
    return Verdict(places, confidences, status, against_all, accuracy)


def _left_over(places: Sequence[Hypothesis], left: float, most: float) -> list[float]:
    """Return confidences of places that come after the best ones: what is left, by their scores, and none above `most`.

    Of each less was measured than of the best, and only one of them is right.
    """
    total = sum(max(place.score, 0.0) for place in places)
    return [min(most, left * max(place.score, 0.0) / max(total, 1e-12)) for place in places]
