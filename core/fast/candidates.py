"""The candidates that a search proposes over all maps of a query, and in which order they are looked at."""

from collections.abc import Sequence

from panoloc.core.config import PhotoRefinementConfig, SearchConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.prepared_query import MapQuery
from panoloc.core.search.map_search import MapCandidates


def best_candidates(queries: Sequence[MapQuery], found: Sequence[MapCandidates], count: int) -> list[Hypothesis]:
    """Return the best `count` candidates over all maps, best first; queries and what was found in their maps go together."""
    hypotheses = []
    for query, part in zip(queries, found, strict=True):
        some = part.candidates
        places = query.index.starts[some.starts] if some.places is None else some.places
        columns = some.scores.tolist(), some.starts.tolist(), part.rotations[some.rotations], places
        for score, start, rotation, place in zip(*columns, strict=True):
            hypotheses.append((score, Hypothesis(query.number, start, rotation, place)))
    hypotheses.sort(key=lambda scored: -scored[0])
    return [hypothesis for _, hypothesis in hypotheses[:count]]


def portions(candidates: Sequence[Hypothesis], config: SearchConfig) -> list[list[Hypothesis]]:
    """Return candidates, best first, in the portions that are refined one after the other, until an answer is sure.

    The first has the very best, and some that are far from the best one: a room that looks the same must not be left for later, when
    nobody asks for it any more.
    """
    if config.first_portion is None or len(candidates) <= config.first_portion:
        return [list(candidates)] if candidates else []
    best = list(candidates[: config.first_portion])
    rest = candidates[config.first_portion :]
    near = sum(h.is_near(best[0], config.elsewhere) for h in best)
    missing = max(0, config.first_elsewhere - (len(best) - near))
    elsewhere = [h for h in rest if not h.is_near(best[0], config.elsewhere)][:missing]
    return [best + elsewhere, [h for h in rest if all(h is not other for other in elsewhere)]]


def most_promising(candidates: Sequence[Hypothesis], config: PhotoRefinementConfig) -> list[Hypothesis]:
    """Return the candidates for photos that are worth refining further after the first steps: those of the smallest loss."""
    kept = max(config.rough_kept, round(config.rough_kept_share * len(candidates)))
    return sorted(candidates, key=lambda candidate: candidate.loss)[:kept]
