"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Session, is_perspective
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import ConfidenceModel, features_of, formal_radii
from panoloc.core.decide.hypotheses import (
    Hypothesis,
    MethodResult,
    by_score,
    with_close_rival,
    with_distinctness,
    with_same_views,
    within_margin,
)
from panoloc.core.decide.verdict import verdict
from panoloc.core.fast.candidate_stages import CandidateStages
from panoloc.core.fast.candidates import best_candidates, portions
from panoloc.core.fast.refinement_steps import RefinementSteps
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.image.photo_atlas import shown_share
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.prepared_panorama import PreparedPanorama
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.prepared_query import MapQuery, SearchRound, prepare_queries, search_rounds
from panoloc.core.refine.focal_refinement import FocalRefined
from panoloc.core.render.comparison import Comparison
from panoloc.core.search.closer_look import search_around
from panoloc.core.search.lookalikes import described_as_scanned, search_lookalikes
from panoloc.core.search.map_search import MapCandidates, make_search_rotations, search_maps
from panoloc.core.search.photo_search import search_photos
from panoloc.core.search.same_views import search_same_views
from panoloc.core.stage_clock import StageClock


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
    ) -> FocalRefined:
        """Return the pose of a hypothesis for photos, refined together with their focal length."""
        return self._of(query, clock).with_focal(query, maps, known)

    def confidence_of_answer(self, hypotheses: Sequence[Hypothesis]) -> float:
        """Return how sure the best of hypotheses would be if it was answered as right, 0 where it would not be."""
        if not hypotheses:
            return 0.0
        found = verdict(hypotheses, self.confidence, self.config.judge)
        return found.together if found.status == "localized" else 0.0

    def evidence(self, hypothesis: Hypothesis) -> float:
        """Return how sure a hypothesis that was refined fully would be if nothing was elsewhere."""
        alone = with_distinctness(hypothesis, [])
        return self.confidence.probability(features_of(alone, 0.0, formal_radii(alone), self.config.judge))

    def is_sure(self, hypotheses: Sequence[Hypothesis], is_last: bool = False) -> bool:
        """Return whether the best hypothesis leaves nothing to search for. is_last: no candidate of the search is left."""
        if not hypotheses:
            return False
        found, search = verdict(hypotheses, self.confidence, self.config.judge), self.config.photo_search
        least = search.sure_at_end if is_last and found.status == "localized" else search.sure
        return found.status != "not_localized" and found.together >= least

    def _of(self, query: Panorama | Session, clock: StageClock) -> "_Run":
        config = self.config.for_photos(shown_share(query)) if isinstance(query, Session) else self.config
        return _Run(self, config, clock)


class _Run:
    """One query on its way through the steps."""

    def __init__(self, method: FastMethod, config: LocalizerConfig, clock: StageClock) -> None:
        self.method, self.config, self.clock = method, config, clock

    def run(self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None) -> MethodResult:
        """Take the steps."""
        with self.clock.stage("prepare"):
            queries = prepare_queries(query, maps, hints, self.config.refinement.finest_height, self.config)
        stages = CandidateStages(queries, self.config, self.clock)
        num_starts, num_poses, judged = 0, 0, list[Hypothesis]()
        hypotheses, comparison = list[Hypothesis](), None
        with self.clock.stage("search"):
            rounds = search_rounds(queries, self.config)
        for searched in rounds:
            with self.clock.stage("search"):
                found = self._search(queries, searched)
                candidates = best_candidates(queries, found, searched.num_candidates)
            num_starts = max(num_starts, sum(part.num_starts for part in found))
            num_poses += sum(part.num_poses for part in found)
            for portion in portions(candidates, self.config.search):
                judged = by_score([*judged, *stages.roughly(portion)], self.config.judge.distinct)
                hypotheses, comparison = self._finish(stages, judged)
                if self.method.is_sure(hypotheses):
                    break
            if self.method.is_sure(hypotheses, is_last=True):
                break
        if hypotheses and self.method.confidence_of_answer(hypotheses) < self.config.judge.weighed_below:
            # The score alone is not worth much then.
            stages.evidence = self.method.evidence
            hypotheses, comparison = self._finish(stages, judged)
        same, alike = self._lookalikes(queries, hypotheses)
        rough = stages.roughly([*same, *alike]) if same else []
        # The place that they were sought from is one of those that look the same: another may fit better yet.
        same = [*hypotheses[:1], *same] if same else []
        if rough:
            hypotheses, comparison = self._finish(stages, judged, rough)
            hypotheses = with_same_views(hypotheses, same, self.config.search.elsewhere)
        if around := self._around(queries, hypotheses):
            judged = by_score([*judged, *stages.roughly(around)], self.config.judge.distinct)
            hypotheses, comparison = self._finish(stages, judged, rough)
            hypotheses = with_same_views(hypotheses, same, self.config.search.elsewhere)
        own = queries[hypotheses[0].map_number] if hypotheses else queries[0]
        edges_deg = own.picture.edges_deg() if isinstance(own.picture, PreparedPhotos) else None
        cloud = own.cloud if hypotheses else None
        pull = stages.focal_pull() if isinstance(query, Session) and is_perspective(query) else 0.0
        return MethodResult(hypotheses, comparison, cloud, num_starts, num_poses, edges_deg, pull)

    def search_score(self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None) -> float:
        """Search, and return the score of the best candidate."""
        queries = prepare_queries(query, maps, hints, self.config.refinement.finest_height, self.config)
        with self.clock.stage("search"):
            found = [
                part for searched in search_rounds(queries, self.config) for part in self._search(queries, searched)
            ]
        return max((float(part.candidates.scores.max()) for part in found if len(part.candidates.scores)), default=0.0)

    def with_focal(self, query: Session, maps: Sequence[MapIndex], known: Hypothesis) -> FocalRefined:
        """Refine a hypothesis and the focal length of the photos."""
        queries = prepare_queries(query, maps, None, self.config.refinement.finest_height, self.config)
        with self.clock.stage("refine"):
            return RefinementSteps(self.config, self.clock).with_focal(queries[known.map_number], known)

    def _finish(
        self, stages: CandidateStages, judged: Sequence[Hypothesis], alike: Sequence[Hypothesis] = ()
    ) -> tuple[list[Hypothesis], Comparison | None]:
        """Refine the best of the poses judged on what they see, and the best of these fully; return them, best first, and how
        the scan compares at the best.

        alike: places that look like the best of them, judged as those were; they go as far as it where they fit half as well.
        """
        sizes, place, search = self.config.refinement, self.config.judge.place, self.config.photo_search
        stages.settle(within_margin(judged, sizes.middle_candidates, sizes.middle_margin, place))
        close = with_close_rival(stages.settled, sizes.fine_candidates, sizes.fine_margin, place)
        if alike:
            fitting = [h for h in alike if h.score >= search.lookalike_least * judged[0].score]
            # One that comes back to where the best is was no other place; how near misses there do is not asked here.
            rivals = stages.settle(
                within_margin(fitting, search.lookalikes_settled, sizes.middle_margin), stages.settled[0]
            )
            fitting = [h for h in rivals if h.score >= search.lookalike_least * stages.settled[0].score]
            close += [h for h in fitting if all(h is not other and not h.is_near(other, place) for other in close)][:1]
        return stages.finals(close, judged)

    def _search(self, queries: Sequence[MapQuery], searched: SearchRound) -> list[MapCandidates]:
        """Search every map as one round of the search wants it."""
        maps = [query.index for query in queries]
        pictures = [query.picture for query in queries]
        photos = [picture.described() for picture in pictures if isinstance(picture, PreparedPhotos)]
        if photos:
            lines = [query.lines if searched.by_lines else None for query in queries]
            return search_photos(photos, maps, searched.limits, lines, self.config.photo_search, self.config.fine_views)
        panoramas = [p.described(self.config.descriptors) for p in pictures if isinstance(p, PreparedPanorama)]
        return search_maps(panoramas, maps, self.method.rotations, searched.limits, self.config.search)

    def _lookalikes(
        self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
    ) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """Return candidates elsewhere from which all of the scan looks as at the best pose, and others that look like it, where photos
        would be answered with it: none of a room that exists twice must be sure because the search overlooked the other."""
        if not self.method.confidence_of_answer(hypotheses):
            return [], []
        best, search = hypotheses[0], self.config.photo_search
        own = queries[best.map_number]
        if not isinstance(own.picture, PreparedPhotos):
            return [], []
        with self.clock.stage("search"):
            alike = [query for query in queries if query.picture is own.picture]
            maps = [(query.index, query.limits) for query in alike]
            found = search_same_views(own.index, best.rotation, best.position, maps, self.config)
            same = best_candidates(alike, found, search.same_views)
            if not same:
                return [], []
            seen = described_as_scanned(own.picture.described(), own.index, best.rotation, best.position, self.config)
            found = [search_lookalikes(seen, *each, best.rotation, self.config) for each in maps]
            candidates = best_candidates(alike, found, search.num_candidates)
        elsewhere = [h for h in candidates if not h.is_near(best, self.config.search.elsewhere)]
        return same, elsewhere[: search.lookalikes]

    def _around(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return candidates near the best pose, where photos that show little would be answered with it, but not beyond doubt.

        Nor is one beyond doubt that refinement tilted so far that it had to be turned back, whatever the photos show: a level one may fit
        better.
        """
        if not hypotheses:
            return []
        search, best = self.config.photo_search, hypotheses[0]
        confidence = self.method.confidence_of_answer([replace(best, is_held_back=False), *hypotheses[1:]])
        if not confidence:
            return []
        is_explained = best.measures["explained"] >= search.doubtful_explained
        if confidence >= search.beyond_doubt and is_explained and not best.is_held_back:
            return []
        own = queries[best.map_number]
        if not isinstance(own.picture, PreparedPhotos):
            return []
        if own.picture.share > search.closer_share and not best.is_held_back:
            return []
        with self.clock.stage("search"):
            seen = own.picture.described()
            found = search_around(seen, own.index, own.limits, own.lines, best.rotation, best.position, self.config)
            return best_candidates([own], [found], search.closer_candidates)
