"""Candidates on their way through refinement and judgement: what earlier portions of them have come to is not worked out again."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.agreement import likeness
from panoloc.core.decide.hypotheses import Hypothesis, by_map, by_score, distinct, merged, with_distinctness
from panoloc.core.fast.refinement_steps import RefinementSteps
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.prepared_query import MapQuery
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.render.comparison import Comparison
from panoloc.core.stage_clock import StageClock


@dataclass
class _Full:
    """A settled hypothesis; itself refined fully and judged, and how the scan compares there; the points that it was refined on; and
    whether halves of the picture were asked."""

    settled: Hypothesis
    final: Hypothesis
    comparison: Comparison
    points: CandidatePoints
    has_halves: bool = False


class CandidateStages:
    """The candidates of one query.

    settled: all that were refined on what they see, by score. evidence: what more of them are refined fully for, and ranked by in place of
    the score, where that leaves doubts; None: where it does not.
    """

    def __init__(self, queries: Sequence[MapQuery], config: LocalizerConfig, clock: StageClock) -> None:
        self.queries, self.config, self.clock = queries, config, clock
        self.refined = RefinementSteps(config, clock)
        self.settled: list[Hypothesis] = []
        self.evidence: Callable[[Hypothesis], float] | None = None
        self._rough: list[Hypothesis] = []  # those settled, as they were before
        self._full: list[_Full] = []
        self._best: _Full | None = None

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
        chosen = self._with_more(chosen)
        finals = sorted(self._refined_fully(chosen), key=lambda full: -self._rank_of(full))
        others = [h for h in self.settled if all(h is not other for other in chosen)]
        if not finals:
            return others, None
        self._best = finals[0]
        best, comparison, place = self._with_halves(finals[0]), finals[0].comparison, self.config.judge.place
        with self.clock.stage("judge"):
            known = sum(not full.final.is_near(best, place) for full in finals)
            rivals, others = self._rivals(best, others, judged, self.config.judge.rivals - known)
            compared = [(full.final, full.comparison) for full in finals[1:]]
            compared += [self.queries[h.map_number].judge_alone(h) for h in rivals]
            beside = [self._beside((best, comparison), *each) for each in compared]
        elsewhere = [h for h in beside if not h.is_near(best, place)]
        # The rest was judged on smaller renderings, where scores are larger: none of it is better than what came before it.
        least = min((h.score for h in elsewhere), default=math.inf)
        others = [replace(h, score=min(h.score, least)) for h in others]
        return [with_distinctness(best, elsewhere), *beside, *others], comparison

    def focal_pull(self) -> float:
        """Return how strongly photos want another focal length at the best of the poses that were refined fully last."""
        if self._best is None or self._best.points.patches is None:
            return 0.0
        best, points = self._best.final, self._best.points
        with self.clock.stage("refine"):
            return self.refined.focal_pull(self.queries[best.map_number], best, points)

    def _with_more(self, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return the chosen, and where evidence ranks the best settled ones of more places."""
        if self.evidence is None:
            return list(chosen)
        judge = self.config.judge
        best = distinct(self.settled, judge.place)[: judge.weighed_places]
        return [*chosen, *(h for h in best if all(h is not other for other in chosen))]

    def _rank_of(self, full: "_Full") -> float:
        return full.final.score if self.evidence is None else self.evidence(self._with_halves(full))

    def _with_halves(self, full: "_Full") -> Hypothesis:
        """Return a hypothesis with how far apart the halves of the picture end from there, which is asked only once of each."""
        if not full.has_halves:
            with self.clock.stage("refine"):
                full.final = self.refined.with_halves(self.queries[full.final.map_number], full.final, full.points)
            full.has_halves = True
        return full.final

    def _refined_fully(self, chosen: Sequence[Hypothesis]) -> list["_Full"]:
        """Return settled ones refined at full resolution and judged; each only once in a query, for the best of a first portion are often
        among those of the next."""
        finals = []
        for hypothesis in chosen:
            query = self.queries[hypothesis.map_number]
            known = next((full for full in self._full if full.settled is hypothesis), None)
            if known is None:
                with self.clock.stage("refine"):
                    refined, points = self.refined.fully(query, hypothesis)
                with self.clock.stage("judge"):
                    known = _Full(hypothesis, *query.judge_alone(refined), points)
                self._full.append(known)
            if query.allows(known.final):
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
