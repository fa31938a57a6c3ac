"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch

from core.config import LocalizerConfig
from core.describe.spherical_patches import PatchGrid
from core.fast.candidates import best_candidates, portions
from core.fast.refinement_steps import RefinementSteps
from core.index.map_index import MapIndex
from core.judge.confidence import ConfidenceModel
from core.judge.hypotheses import (
    Hypothesis,
    MethodResult,
    by_map,
    by_score,
    merged,
    with_close_rival,
    within_margin,
)
from core.judge.verdict import verdict
from core.options import Hints
from core.panorama.panorama import Panorama
from core.panorama.photo_atlas import shown_share
from core.panorama.session import Session
from core.prepared_panorama import PreparedPanorama
from core.prepared_photos import PreparedPhotos
from core.prepared_query import MapQuery, prepare_queries, search_limits
from core.search.map_search import MapCandidates, make_search_rotations, search_maps
from core.search.photo_search import search_photos
from core.search.pose_limits import PoseLimits
from core.stage_clock import StageClock
from core.views.comparison import Comparison


class FastMethod:
    """Holds what does not change between queries: configuration and rotations."""

    def __init__(self, config: LocalizerConfig, device: torch.device, confidence: ConfidenceModel) -> None:
        self.config, self.confidence = config, confidence
        grid = PatchGrid(config.descriptors.patch_rows, config.descriptors.patch_columns)
        self.rotations = make_search_rotations(config.search, grid, device)

    def run(
        self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock
    ) -> MethodResult:
        """Return hypotheses over all maps, best first; none when the hints leave nothing to search.

        Poses of the photos of a session are those of its axes, from the middle of its cameras.
        """
        return self._of(query, clock).run(query, maps, hints)

    def search_score(
        self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock
    ) -> float:
        """Return the score of the best candidate that the search finds, before any refinement; 0 without one."""
        return self._of(query, clock).search_score(query, maps, hints)

    def with_focal(
        self, query: Session, maps: Sequence[MapIndex], known: Hypothesis, clock: StageClock
    ) -> tuple[Hypothesis, float]:
        """Return a hypothesis for a single photo, refined together with its focal length, and by which factor that grows."""
        return self._of(query, clock).with_focal(query, maps, known)

    def is_sure(self, hypotheses: Sequence[Hypothesis]) -> bool:
        """Return whether the best hypothesis leaves nothing to search for."""
        if not hypotheses:
            return False
        found = verdict(hypotheses, self.confidence, self.config.judge)
        return found.status == "localized" and found.confidences[0] >= self.config.photo_search.sure

    def _of(self, query: Panorama | Session, clock: StageClock) -> "_Run":
        config = self.config.for_photos(shown_share(query)) if isinstance(query, Session) else self.config
        return _Run(self, config, clock)


@dataclass
class _Done:
    """What earlier portions of candidates have come to, so that nothing is refined twice.

    rough: candidates as they were before they were refined on what they see; settled: all of them after it, by score; finals: settled
    ones, each with itself refined fully and the comparison there.
    """

    rough: list[Hypothesis] = field(default_factory=list)
    settled: list[Hypothesis] = field(default_factory=list)
    finals: list[tuple[Hypothesis, tuple[Hypothesis, Comparison]]] = field(default_factory=list)


class _Run:
    """One query on its way through the steps."""

    def __init__(self, method: FastMethod, config: LocalizerConfig, clock: StageClock) -> None:
        self.method, self.config, self.clock = method, config, clock
        self.refined = RefinementSteps(config, clock)
        self._done = _Done()

    def run(self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None) -> MethodResult:
        """Take the steps."""
        with self.clock.stage("prepare"):
            queries = prepare_queries(query, maps, hints, self.config.refinement.finest_height, self.config)
        num_starts, num_poses, judged = 0, 0, list[Hypothesis]()
        hypotheses, comparison = list[Hypothesis](), None
        for searched, count in self._searches(queries):
            with self.clock.stage("search"):
                found = self._search(queries, searched)
                candidates = best_candidates(queries, found, count)
            num_starts = max(num_starts, sum(part.num_starts for part in found))
            num_poses += sum(part.num_poses for part in found)
            for portion in portions(candidates, self.config.search):
                judged = self._refine_roughly(queries, portion, judged)
                hypotheses, comparison = self._finish(queries, judged)
                if self.method.is_sure(hypotheses):
                    break
            if self.method.is_sure(hypotheses):
                break
        cloud = queries[hypotheses[0].map_number].cloud if hypotheses else None
        return MethodResult(hypotheses, comparison, cloud, num_starts, num_poses)

    def search_score(self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None) -> float:
        """Search, and return the score of the best candidate."""
        queries = prepare_queries(query, maps, hints, self.config.refinement.finest_height, self.config)
        with self.clock.stage("search"):
            found = [part for limits, _ in self._searches(queries) for part in self._search(queries, limits)]
        return max((float(part.candidates.scores.max()) for part in found if len(part.candidates.scores)), default=0.0)

    def with_focal(self, query: Session, maps: Sequence[MapIndex], known: Hypothesis) -> tuple[Hypothesis, float]:
        """Refine a hypothesis and the focal length of the only photo."""
        queries = prepare_queries(query, maps, None, self.config.refinement.finest_height, self.config)
        with self.clock.stage("refine"):
            return self.refined.with_focal(queries[known.map_number], known)

    def _searches(self, queries: Sequence[MapQuery]) -> list[tuple[list[PoseLimits], int]]:
        """Return the limits of one search after the other, and how many candidates it has; fewer where another may follow."""
        *first, last = search_limits(queries, self.config.photo_search)
        counts = self.config.photo_search.level_candidates, self.config.search.num_candidates
        return [*((limits, counts[0]) for limits in first), (last, counts[1])]

    def _refine_roughly(
        self, queries: Sequence[MapQuery], candidates: Sequence[Hypothesis], judged: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """Refine candidates on what their starts see, and return them by score among those that were judged before."""
        judge = self.config.judge
        with self.clock.stage("refine"):
            refined = self.refined.on_starts(queries, candidates)
        with self.clock.stage("judge"):
            new = self._judge(queries, merged(refined, judge.merged), judge.first_height)
            return by_score([*judged, *new], judge.distinct)

    def _finish(
        self, queries: Sequence[MapQuery], judged: Sequence[Hypothesis]
    ) -> tuple[list[Hypothesis], Comparison | None]:
        """Refine the best of the poses judged on what they see, and the best of these fully; return them, best first, and how
        the scan compares at the best."""
        sizes, place = self.config.refinement, self.config.judge.place
        hypotheses = self._settled(queries, within_margin(judged, sizes.middle_candidates, sizes.middle_margin, place))
        close = with_close_rival(hypotheses, sizes.fine_candidates, sizes.fine_margin, place)
        finals = sorted(self._refined_fully(queries, close), key=lambda final: -final[0].score)
        best = [h for h, _ in finals]
        with self.clock.stage("judge"):
            left = [h for h in hypotheses if all(h is not other for other in close)]
            others = self._judge_rival(queries, best, self._with_rival(best, left, judged))
        return [*best, *others], finals[0][1] if finals else None

    def _settled(self, queries: Sequence[MapQuery], chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine those of the chosen that were not yet on what they see; return all that ever were, by score."""
        judge, done = self.config.judge, self._done
        new = [h for h in chosen if all(h is not other for other in done.rough)]
        with self.clock.stage("refine"):
            refined = self.refined.on_poses(queries, new)
        with self.clock.stage("judge"):
            allowed = [h for h in self._judge(queries, refined, judge.height) if queries[h.map_number].allows(h)]
        done.rough += new
        done.settled = by_score([*done.settled, *allowed], judge.distinct)
        return done.settled

    def _refined_fully(
        self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
    ) -> list[tuple[Hypothesis, Comparison]]:
        """Return hypotheses refined at full resolution and judged, with the comparison; each only once in a query, for the best of
        a first portion are often among those of the next."""
        finals = []
        for hypothesis in hypotheses:
            query = queries[hypothesis.map_number]
            known = next((final for settled, final in self._done.finals if settled is hypothesis), None)
            if known is None:
                with self.clock.stage("refine"):
                    refined = self.refined.fully(query, hypothesis)
                with self.clock.stage("judge"):
                    known = query.judge_alone(refined)
                self._done.finals.append((hypothesis, known))
            if query.allows(known[0]):
                finals.append(known)
        return finals

    def _search(self, queries: Sequence[MapQuery], limits: Sequence[PoseLimits]) -> list[MapCandidates]:
        """Search every map within its limits."""
        maps = [query.index for query in queries]
        pictures = [query.picture for query in queries]
        photos = [picture.described() for picture in pictures if isinstance(picture, PreparedPhotos)]
        if photos:
            return search_photos(photos, maps, limits, self.config.photo_search, self.config.fine_views)
        panoramas = [p.described(self.config.descriptors) for p in pictures if isinstance(p, PreparedPanorama)]
        return search_maps(panoramas, maps, self.method.rotations, limits, self.config.search)

    def _judge(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis], height: int) -> list[Hypothesis]:
        """Return hypotheses by falling score on renderings of `height` rows, one for each pose."""
        judged = [h for number, group in by_map(hypotheses) for h in queries[number].judge(group, height)]
        return by_score(judged, self.config.judge.distinct)

    def _with_rival(
        self, finals: Sequence[Hypothesis], others: Sequence[Hypothesis], judged: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """Return the others, and where all of them have come to the best place the best of the poses `judged` before that was elsewhere.

        How far it is behind says how sure the answer is, although it was not refined further.
        """
        place, others = self.config.judge.place, list(others)
        if not finals or any(not h.is_near(finals[0], place) for h in (*finals, *others)):
            return others
        return others + [h for h in judged if not h.is_near(finals[0], place)][:1]

    def _judge_rival(
        self, queries: Sequence[MapQuery], finals: Sequence[Hypothesis], others: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """Judge the best candidate at another place on the larger rendering too: the margin must compare like with like."""
        place, others = self.config.judge.place, list(others)
        if finals and all(h.is_near(finals[0], place) for h in finals):
            for k, rival in enumerate(others):
                if not rival.is_near(finals[0], place):
                    others[k] = queries[rival.map_number].judge_alone(rival)[0]
                    break
        return others
