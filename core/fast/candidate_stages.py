"""Candidates on their way through refinement and judgement: what earlier portions of them have come to is not worked out again."""

import math
from collections.abc import Sequence
from dataclasses import replace

from core.config import LocalizerConfig
from core.fast.refinement_steps import RefinementSteps
from core.judge.agreement import likeness
from core.judge.hypotheses import Hypothesis, by_map, by_score, distinct, merged, with_distinctness
from core.prepared_photos import PreparedPhotos
from core.prepared_query import MapQuery
from core.stage_clock import StageClock
from core.views.comparison import Comparison


class CandidateStages:
    """The candidates of one query. settled: all that were refined on what they see, by score."""

    def __init__(self, queries: Sequence[MapQuery], config: LocalizerConfig, clock: StageClock) -> None:
        self.queries, self.config, self.clock = queries, config, clock
        self.refined = RefinementSteps(config, clock)
        self.settled: list[Hypothesis] = []
        self._rough: list[Hypothesis] = []  # those settled, as they were before
        # Settled ones, each with itself refined fully and the comparison there.
        self._full: list[tuple[Hypothesis, tuple[Hypothesis, Comparison]]] = []

    def roughly(self, candidates: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine candidates on what their starts see and return them judged, by score."""
        judge = self.config.judge
        with self.clock.stage("refine"):
            refined = self.refined.on_starts(self.queries, candidates)
        with self.clock.stage("judge"):
            return self._judged(merged(refined, judge.merged), judge.first_height)

    def settle(self, chosen: Sequence[Hypothesis], apart_from: Hypothesis | None = None) -> list[Hypothesis]:
        """Refine those of the chosen that were not yet on what they see, and return these, judged, by score.

        apart_from: those that end at the place of this one are left out.
        """
        judge = self.config.judge
        new = [h for h in chosen if all(h is not other for other in self._rough)]
        with self.clock.stage("refine"):
            refined = self.refined.on_poses(self.queries, new)
        with self.clock.stage("judge"):
            allowed = [h for h in self._judged(refined, judge.height) if self.queries[h.map_number].allows(h)]
        if apart_from is not None:
            allowed = [h for h in allowed if not h.is_near(apart_from, self.config.search.elsewhere)]
        self._rough += new
        self.settled = by_score([*self.settled, *allowed], judge.distinct)
        return allowed

    def finals(
        self, chosen: Sequence[Hypothesis], judged: Sequence[Hypothesis]
    ) -> tuple[list[Hypothesis], Comparison | None]:
        """Refine settled ones fully; return them and then all others, best first, and how the scan compares at the best.

        judged: poses judged before any was settled, by score.
        """
        finals = sorted(self._refined_fully(chosen), key=lambda final: -final[0].score)
        others = [h for h in self.settled if all(h is not other for other in chosen)]
        if not finals:
            return others, None
        best, place = finals[0][0], self.config.judge.place
        with self.clock.stage("judge"):
            known = sum(not h.is_near(best, place) for h, _ in finals)
            rivals, others = self._rivals(best, others, judged, self.config.judge.rivals - known)
            compared = [*finals[1:], *(self.queries[h.map_number].judge_alone(h) for h in rivals)]
            beside = [self._beside(finals[0], *final) for final in compared]
        elsewhere = [h for h in beside if not h.is_near(best, place)]
        # The rest was judged on smaller renderings, where scores are larger: none of it is better than what came before it.
        least = min((h.score for h in elsewhere), default=math.inf)
        others = [replace(h, score=min(h.score, least)) for h in others]
        return [with_distinctness(best, elsewhere), *beside, *others], finals[0][1]

    def _refined_fully(self, chosen: Sequence[Hypothesis]) -> list[tuple[Hypothesis, Comparison]]:
        """Return settled ones refined at full resolution and judged, with the comparison; each only once in a query, for the best of
        a first portion are often among those of the next."""
        finals = []
        for hypothesis in chosen:
            query = self.queries[hypothesis.map_number]
            known = next((final for settled, final in self._full if settled is hypothesis), None)
            if known is None:
                with self.clock.stage("refine"):
                    refined = self.refined.fully(query, hypothesis)
                with self.clock.stage("judge"):
                    known = query.judge_alone(refined)
                self._full.append((hypothesis, known))
            if query.allows(known[0]):
                finals.append(known)
        return finals

    def _judged(self, hypotheses: Sequence[Hypothesis], height: int) -> list[Hypothesis]:
        """Return hypotheses by falling score on renderings of `height` rows, one for each pose."""
        judged = [h for number, group in by_map(hypotheses) for h in self.queries[number].judge(group, height)]
        return by_score(judged, self.config.judge.distinct)

    def _rivals(
        self, best: Hypothesis, others: Sequence[Hypothesis], judged: Sequence[Hypothesis], count: int
    ) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """Return the best `count` of the others at places of their own, to be judged as the best was, for margins must compare like with
        like; and the rest.

        Where all others are at the best place, the best of the poses `judged` before that was elsewhere is the rival: how far it is
        behind says how sure the answer is, although it was not refined further.
        """
        place = self.config.judge.place
        if count <= 0:
            return [], list(others)
        elsewhere = distinct([h for h in others if not h.is_near(best, place)], place)
        if not elsewhere:
            return [h for h in judged if not h.is_near(best, place)][:1], list(others)
        rivals = elsewhere[:count]
        return rivals, [h for h in others if all(h is not rival for rival in rivals)]

    def _beside(
        self, best: tuple[Hypothesis, Comparison], hypothesis: Hypothesis, comparison: Comparison
    ) -> Hypothesis:
        """Return a hypothesis with how much what photos would show there is like what they would show at the best; what is near the best
        looks like it in any case, which says nothing."""
        picture = self.queries[hypothesis.map_number].picture
        if not isinstance(picture, PreparedPhotos) or picture is not self.queries[best[0].map_number].picture:
            return hypothesis
        if hypothesis.is_near(best[0], self.config.search.elsewhere):
            return hypothesis
        return replace(hypothesis, likeness=likeness(comparison, best[1], self.config.judge, picture.share))
