"""The engine. The order of the steps of a query is written here and nowhere else:

prepare, for each focal length that the rig may have → refine and judge where the caller expects the rig
→ unless that is sure, or the caller wants nothing else, for each round:
  propose, for each focal length → refine coarse, judge
  → of the focal length that fits best: refine medium, judge → refine fine, judge → stop when sure
→ of an image whose extent is not known, the same with others, nearer and nearer
→ the same for aliases of the best pose, and for other focal lengths.

For a session that is localized, `localizer.py` may then run the first image by itself, where the others put it.
"""

import math
from collections.abc import Callable, Sequence

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import NO_NOISE, Hypothesis, MethodResult
from panoloc.core.decide.verdict import Verdict, verdict
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.contest import Contest
from panoloc.core.query.focal_lengths import FoundCameras, found_cameras, guesses
from panoloc.core.query.map_query import prepare_queries
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

        def contest_of(rig: Rig) -> Contest:
            """Return the contest of the poses of a rig, one guess at that which is given."""
            with clock.stage("prepare"):
                return Contest(rig, prepare_queries(rig, maps, hints, self.config, given), self.config, clock)

        contests = [contest_of(rig) for rig in guesses(given, self.config.focal)]
        contest, num_starts, num_poses = self._where_expected(contests, hints), 0, 0
        if contest is None:
            contest, num_starts, num_poses = self._search(contests, clock)
        if given.has_unsure_extent:
            contest = self._closer(given, contest, contest_of)
        queries = contest.queries
        if hints is None or not hints.has_only_prior:
            self._add_aliases(contest, clock)
        contest.add_focal_lengths()
        own = queries[contest.hypotheses[0].map_number] if contest.hypotheses else queries[0]
        result = MethodResult(
            contest.hypotheses,
            contest.comparison,
            num_starts,
            num_poses,
            self.config.search.rotations_with(self.config.search.halvings(own.rig.is_wide)),
            None if own.rig.is_wide or own.rig.is_labels else own.rig.edges.length_deg,
            contest.noise,
        )
        return result, found_cameras(given, contest.rig, result.hypotheses, self.config.focal)

    def _where_expected(self, contests: Sequence[Contest], hints: Hints | None) -> Contest | None:
        """Return the contest whose rig is surely where the caller expects it, or fits best there and he wants no other answer: then
        nothing is searched. Else None."""
        if hints is None or hints.prior is None or len(contests[0].queries) != 1:
            return None
        for contest in contests:
            contest.most_margin = self.config.refinement.margin
            contest.take(poses_of_prior(contest.queries[0], hints.prior))
        best = max(contests, key=Contest.best_score)
        # The last steps take the most time; what fits badly before them is no answer after them.
        if hints.prior.is_only or best.is_promising(self.confidence):
            best.rank()
            if hints.prior.is_only or self.is_sure(best):
                return best
        for contest in contests:
            contest.most_margin = None
        return None

    def _search(self, contests: Sequence[Contest], clock: StageClock) -> tuple[Contest, int, int]:
        """Take rounds of search until an answer is sure; return the contest that it is from, how many starts there were, and poses scored.

        contests: one for each focal length that the rig may have. In each round that one goes on which fits best so far.
        """
        num_starts = num_poses = 0
        rounds = [rounds_of(contest.queries, self.config.search) for contest in contests]
        best = contests[0]
        left: list[list[list[Hypothesis]]] = [[] for _ in contests]
        while True:
            with clock.stage("search"):
                searched = [next(of_contest, None) for of_contest in rounds]
            if not any(searched):
                break
            for contest, of_contest, portions in zip(contests, searched, left, strict=True):
                if of_contest is None:
                    continue
                with clock.stage("search"):
                    proposed, of_starts, of_poses = propose(contest.queries, of_contest, self.config.search)
                num_starts, num_poses = max(num_starts, of_starts), num_poses + of_poses
                if proposed:
                    contest.take(proposed[0])
                    portions += proposed[1:]
            best, portions = max(zip(contests, left, strict=True), key=lambda pair: pair[0].best_score())
            best.rank()
            while portions and not self.is_sure(best):
                best.add(portions.pop(0))
            if self.is_sure(best):
                break
        return best, num_starts, num_poses

    def _closer(self, given: Rig, guess: Contest, contest_of: Callable[[Rig], Contest]) -> Contest:
        """Return the contest for the extent of an image with which the best pose fits best: the guess, or one beside it. Steps halve until
        they are a pixel. Poses elsewhere stay rivals."""
        best, step = guess, self.config.focal.step / 2
        finest = math.pi / (2 * self.config.refinement.fine_rows)
        # The stated extent counts more than others: smaller steps do not gain as much.
        while best.hypotheses and step > (self.config.focal.step / 8 if best.rig is given else finest):
            ways = ((-step, 0.0), (step, 0.0), (0.0, -step), (0.0, step))
            beside = [contest_of(rig) for way in ways if (rig := best.rig.with_other_extent(*way)) is not None]
            for other in beside:
                other.add(best.hypotheses[:1])
            better = max([best, *beside], key=Contest.ranked_score)
            step = step / 2 if better is best else step
            best = better
        if best is not guess:
            best.add(guess.hypotheses)
        return best

    def _add_aliases(self, contest: Contest, clock: StageClock) -> None:
        """Let the aliases of the best pose compete with it, if it would be told without rivals: until then they are rivals like others."""
        if not contest.hypotheses or self._verdict(contest, num_places=1).status != "localized":
            return
        with clock.stage("search"):
            aliases = aliases_of_pose(contest.queries, contest.hypotheses[0])
        if aliases:
            contest.add_aliases(aliases)

    def _verdict(self, contest: Contest, num_places: int | None = None) -> Verdict:
        """Return the verdict over the first so many of the hypotheses."""
        noise = NO_NOISE if contest.is_guess else contest.noise
        return verdict(contest.hypotheses[:num_places], self.confidence, noise)

    def is_sure(self, contest: Contest) -> bool:
        """Return whether the best hypothesis leaves nothing to search for; of equal places none is so sure."""
        return bool(contest.hypotheses) and self._verdict(contest).confidences[0] >= self.config.judge.sure
