"""The engine. The order of the steps of a query is written here and nowhere else:

prepare → refine and judge where the caller expects the rig
→ unless that is localized, or the caller wants nothing else, for each round:
  propose → refine coarse, judge → refine medium, judge → refine fine, judge → stop when sure
→ the same for aliases of the best pose, and for other focal lengths.
"""

from collections.abc import Sequence

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import MethodResult
from panoloc.core.decide.verdict import Verdict, verdict
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints, Status
from panoloc.core.query.contest import Contest
from panoloc.core.query.focal_lengths import FoundCameras, focal_prior, found_cameras, guesses
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.query.rounds import aliases_of_pose, poses_of_prior, propose, rounds_of
from panoloc.core.stage_clock import StageClock


class Engine:
    """Holds what does not change between queries."""

    def __init__(self, config: LocalizerConfig, confidence: ConfidenceModel) -> None:
        self.config, self.confidence = config, confidence

    def run(
        self, given: Rig, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock
    ) -> tuple[MethodResult, FoundCameras]:
        """Return hypotheses over all maps, best first, none when the hints leave nothing to search; and the cameras of the best.

        Poses are those of the rig's axes.
        """
        is_only = hints is not None and hints.has_only_prior
        rig = given if is_only else self._guessed(given, maps, hints, clock)
        with clock.stage("prepare"):
            queries = prepare_queries(rig, maps, hints, self.config)
        contest = Contest(rig, queries, self.config, clock)
        num_starts, num_poses = 0, 0
        if not self._is_where_expected(queries, hints, contest):
            num_starts, num_poses = self._search(queries, contest, clock)
        if self.status(contest) != "not_localized" and not is_only:
            with clock.stage("search"):
                aliases = aliases_of_pose(queries, contest.hypotheses[0])
            if aliases:
                contest.add_aliases(aliases)
        contest.add_focal_lengths()
        own = queries[contest.hypotheses[0].map_number] if contest.hypotheses else queries[0]
        result = MethodResult(
            contest.hypotheses,
            contest.comparison,
            own.cloud if contest.hypotheses else None,
            num_starts,
            num_poses,
            self.config.search.rotations_with(self.config.search.halvings(own.rig.is_wide)),
            None if own.rig.is_wide or own.rig.is_labels else own.rig.edges.length_deg,
            contest.noise,
        )
        return result, found_cameras(given, rig, result.hypotheses)

    def _is_where_expected(self, queries: Sequence[MapQuery], hints: Hints | None, contest: Contest) -> bool:
        """Return whether the rig is localized where the caller expects it, or he wants no other answer: then nothing is searched."""
        if hints is None or hints.prior is None or len(queries) != 1:
            return False
        contest.most_margin = self.config.refinement.margin
        if hints.prior.is_only:
            contest.add(poses_of_prior(queries[0], hints.prior))
            return True
        # The last steps take the most time; what fits badly before them is no answer after them.
        expected = poses_of_prior(queries[0], hints.prior)
        if contest.add_promising(expected, self.confidence) and self.status(contest) == "localized":
            return True
        contest.most_margin = None
        return False

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
        return num_starts, num_poses

    def _guessed(self, rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> Rig:
        """Return the rig with the focal length that the search likes best, of those that it may have; as it is where that is stated."""
        prior = focal_prior(rig, self.config.focal)
        if prior is None or prior.is_stated:
            return rig

        def score(guess: Rig) -> float:
            """Return the score of the best candidate that the search finds, before any refinement; 0 without one."""
            queries = prepare_queries(guess, maps, hints, self.config)
            with clock.stage("search"):
                rounds = rounds_of(queries, self.config.search)
                return max(propose(queries, searched, self.config.search).best_score for searched in rounds)

        return max(guesses(rig, prior, self.config.focal.step), key=score)

    def _verdict(self, contest: Contest) -> Verdict:
        return verdict(contest.hypotheses, self.confidence, contest.noise)

    def status(self, contest: Contest) -> Status:
        """Return what would be said of the best of hypotheses."""
        return self._verdict(contest).status if contest.hypotheses else "not_localized"

    def is_sure(self, contest: Contest) -> bool:
        """Return whether the best hypothesis leaves nothing to search for; of equal places none is so sure."""
        return bool(contest.hypotheses) and self._verdict(contest).confidences[0] >= self.config.judge.sure
