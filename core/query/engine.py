"""The engine. The order of the steps of a query is written here and nowhere else:

prepare → for each round: propose → refine coarse, judge → refine medium, judge → refine fine, judge → stop when sure
→ the same for aliases of the best pose, and for what is near it.
"""

from collections.abc import Sequence

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import Hypothesis, MethodResult
from panoloc.core.decide.verdict import Verdict, verdict
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.contest import Contest
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.query.refinement import Refinement
from panoloc.core.query.rounds import aliases_of_pose, propose, propose_near, rounds_of
from panoloc.core.refine.focal_refinement import FocalRefined
from panoloc.core.stage_clock import StageClock


class Engine:
    """Holds what does not change between queries."""

    def __init__(self, config: LocalizerConfig, confidence: ConfidenceModel) -> None:
        self.config, self.confidence = config, confidence

    def run(self, rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return hypotheses over all maps, best first; none when the hints leave nothing to search.

        Their poses are those of the rig's axes.
        """
        with clock.stage("prepare"):
            queries = prepare_queries(rig, maps, hints, self.config)
        contest = Contest(rig, queries, self.config, clock)
        num_starts, num_poses = self._search(queries, contest, clock)
        if self.is_answer(contest):
            with clock.stage("search"):
                aliases = aliases_of_pose(queries, contest.hypotheses[0])
            if aliases:
                contest.add_aliases(aliases)
        if self._is_doubtful(queries, contest):
            best = contest.hypotheses[0]
            with clock.stage("search"):
                near = propose_near(queries[best.map_number], best, self.config.search)
            contest.add(near)
        own = queries[contest.hypotheses[0].map_number] if contest.hypotheses else queries[0]
        return MethodResult(
            contest.hypotheses,
            contest.comparison,
            own.cloud if contest.hypotheses else None,
            num_starts,
            num_poses,
            self.config.search.wide_rotations if own.rig.is_wide else self.config.search.narrow_rotations,
            None if own.rig.is_wide or own.rig.is_labels else own.rig.edges.length_deg,
            contest.focal_pull() if rig.has_focal_length else 0.0,
            contest.noise,
        )

    def _search(self, queries: Sequence[MapQuery], contest: Contest, clock: StageClock) -> tuple[int, int]:
        """Take rounds of search until an answer is sure; return how many starts there were, and poses scored."""
        num_starts = num_poses = 0
        with clock.stage("search"):
            rounds = rounds_of(queries, self.config.search)
        for searched in rounds:
            with clock.stage("search"):
                found = propose(queries, searched, self.config.search)
            num_starts, num_poses = max(num_starts, found.num_starts), num_poses + found.num_poses
            for portion in found.portions:
                contest.add(portion)
                if self.is_sure(contest):
                    return num_starts, num_poses
            if self.is_sure(contest, is_last=True):
                break
        return num_starts, num_poses

    def search_score(self, rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> float:
        """Return the score of the best candidate that the search finds, before any refinement; 0 without one."""
        queries = prepare_queries(rig, maps, hints, self.config)
        with clock.stage("search"):
            found = [
                propose(queries, searched, self.config.search) for searched in rounds_of(queries, self.config.search)
            ]
        return max((each.best_score for each in found), default=0.0)

    def with_focal(self, rig: Rig, maps: Sequence[MapIndex], known: Hypothesis, clock: StageClock) -> FocalRefined:
        """Return the pose of a hypothesis, refined together with the focal length of the images."""
        queries = prepare_queries(rig, maps, None, self.config)
        with clock.stage("refine"):
            return Refinement(queries, self.config, clock).with_focal(queries[known.map_number], known)

    def confidence_of_answer(self, result: Contest | MethodResult) -> float:
        """Return how sure the best of hypotheses would be if it was answered as right, 0 where it would not be."""
        if not result.hypotheses:
            return 0.0
        found = self._verdict(result)
        return found.together if found.status == "localized" else 0.0

    def _verdict(self, result: Contest | MethodResult) -> Verdict:
        return verdict(result.hypotheses, self.confidence, self.config.judge, result.noise)

    def is_answer(self, result: Contest | MethodResult) -> bool:
        """Return whether the best of hypotheses would be answered, alone or with its equals."""
        return bool(result.hypotheses) and self._verdict(result).status != "not_localized"

    def is_sure(self, contest: Contest, is_last: bool = False) -> bool:
        """Return whether the best hypothesis leaves nothing to search for. is_last: no candidate of the search is left."""
        if not contest.hypotheses:
            return False
        judge, found = self.config.judge, self._verdict(contest)
        least = judge.sure_at_end if is_last and found.status == "localized" else judge.sure
        return found.status != "not_localized" and found.together >= least

    def _is_doubtful(self, queries: Sequence[MapQuery], contest: Contest) -> bool:
        """Return whether a rig that shows little would be answered with the best hypothesis, but not for certain."""
        confidence, judge = self.confidence_of_answer(contest), self.config.judge
        if not confidence or queries[contest.hypotheses[0].map_number].rig.share > judge.narrow_share:
            return False
        is_explained = contest.hypotheses[0].measures["explained"] >= judge.doubtful_explained
        return confidence < judge.beyond_doubt or not is_explained
