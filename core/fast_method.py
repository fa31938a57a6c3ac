"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from core.config import LocalizerConfig, StepConfig, StoppingRule
from core.describe.spherical_patches import PatchGrid
from core.index.map_index import MapIndex
from core.judge.confidence import ConfidenceModel
from core.judge.hypotheses import (
    Hypothesis,
    MethodResult,
    by_map,
    by_score,
    merged,
    stacked_poses,
    with_close_rival,
    with_refined,
    within_margin,
)
from core.judge.verdict import verdict
from core.options import Hints
from core.panorama.image_level import ImageLevel
from core.panorama.panorama import Panorama
from core.panorama.photo_atlas import shown_share
from core.panorama.session import Session
from core.prepared_panorama import PreparedPanorama
from core.prepared_photos import PreparedPhotos
from core.prepared_query import MapQuery, by_colors, prepare_queries, search_limits, within_limits
from core.refine.refinement import CandidatePoints, joined, refine
from core.refine.rig_level import RigLevel
from core.search.map_search import MapCandidates, SearchRotations, make_search_rotations, search_maps
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
        if isinstance(query, Session):
            config = self.config.for_photos(shown_share(query))
            return _Run(config, self.rotations, self.confidence, clock).run(query, maps, hints)
        return _Run(self.config, self.rotations, self.confidence, clock).run(query, maps, hints)


class _Run:
    """One query on its way through the steps."""

    def __init__(
        self, config: LocalizerConfig, rotations: SearchRotations, confidence: ConfidenceModel, clock: StageClock
    ) -> None:
        self.config, self.rotations, self.confidence, self.clock = config, rotations, confidence, clock

    def run(self, query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None) -> MethodResult:
        """Take the steps."""
        judge, clock = self.config.judge, self.clock
        with clock.stage("prepare"):
            queries = prepare_queries(query, maps, hints, self.config.refinement.finest_height, self.config)
        num_starts, num_poses, judged = 0, 0, list[Hypothesis]()
        searches = search_limits(queries, self.config.photo_search)
        for number, searched in enumerate(searches, start=1):
            with clock.stage("search"):
                found = self._search(queries, searched)
                hypotheses = self._candidates(queries, found, is_last=number == len(searches))
            num_starts = max(num_starts, sum(part.num_starts for part in found))
            num_poses += sum(part.num_poses for part in found)
            with clock.stage("refine"):
                hypotheses = self._refine_on_starts(queries, hypotheses)
            with clock.stage("judge"):
                merged_ones = merged(hypotheses, judge.merged)
                judged = by_score([*judged, *self._judge(queries, merged_ones, judge.first_height)], judge.distinct)
            hypotheses, comparison = self._finish(queries, judged)
            if self._is_sure(hypotheses):
                break
        cloud = queries[hypotheses[0].map_number].cloud if hypotheses else None
        return MethodResult(hypotheses, comparison, cloud, num_starts, num_poses)

    def _finish(
        self, queries: Sequence[MapQuery], judged: Sequence[Hypothesis]
    ) -> tuple[list[Hypothesis], Comparison | None]:
        """Refine the best of the poses judged on what they see, and the best of these fully; return them, best first, and how
        the scan compares at the best."""
        sizes, judge, clock = self.config.refinement, self.config.judge, self.clock
        hypotheses = within_margin(judged, sizes.middle_candidates, sizes.middle_margin, judge.place)
        with clock.stage("refine"):
            hypotheses = self._refine_on_poses(queries, hypotheses)
        with clock.stage("judge"):
            hypotheses = [h for h in self._judge(queries, hypotheses, judge.height) if queries[h.map_number].allows(h)]
        with clock.stage("refine"):
            close = with_close_rival(hypotheses, sizes.fine_candidates, sizes.fine_margin, judge.place)
            fine = [self._refine_fully(queries[h.map_number], h) for h in close]
        with clock.stage("judge"):
            allowed = [queries[h.map_number].judge_alone(h) for h in fine if queries[h.map_number].allows(h)]
            finals = sorted(allowed, key=lambda final: -final[0].score)
            best = [h for h, _ in finals]
            left = [h for h in hypotheses if all(h is not other for other in close)]
            others = self._judge_rival(queries, best, self._with_rival(best, left, judged))
        return [*best, *others], finals[0][1] if finals else None

    def _is_sure(self, hypotheses: Sequence[Hypothesis]) -> bool:
        """Return whether the best hypothesis leaves nothing to search for."""
        if not hypotheses:
            return False
        found = verdict(hypotheses, self.confidence, self.config.judge)
        return found.status == "localized" and found.confidences[0] >= self.config.photo_search.sure

    def _search(self, queries: Sequence[MapQuery], limits: Sequence[PoseLimits]) -> list[MapCandidates]:
        """Search every map within its limits."""
        maps = [query.index for query in queries]
        pictures = [query.picture for query in queries]
        photos = [picture.described() for picture in pictures if isinstance(picture, PreparedPhotos)]
        if photos:
            return search_photos(photos, maps, limits, self.config.photo_search, self.config.fine_views)
        panoramas = [p.described(self.config.descriptors) for p in pictures if isinstance(p, PreparedPanorama)]
        return search_maps(panoramas, maps, self.rotations, limits, self.config.search)

    def _candidates(
        self, queries: Sequence[MapQuery], found: Sequence[MapCandidates], is_last: bool
    ) -> list[Hypothesis]:
        """Return the best candidates over all maps; fewer where another search may follow."""
        hypotheses = []
        for query, part in zip(queries, found, strict=True):
            columns = part.candidates.scores, part.candidates.starts, part.candidates.rotations
            for score, start, turn in zip(*(column.tolist() for column in columns), strict=True):
                pose = part.rotations[turn], query.index.starts[start]
                hypotheses.append((score, Hypothesis(query.number, start, *pose)))
        hypotheses.sort(key=lambda scored: -scored[0])
        count = self.config.search.num_candidates if is_last else self.config.photo_search.level_candidates
        return [hypothesis for _, hypothesis in hypotheses[:count]]

    def _refine_on_starts(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on what the starts see, at half the rows of a view and at all of them."""
        sizes, refined = self.config.refinement, []
        for picture, group in by_colors(queries, hypotheses):
            for coarse, iterations in zip((True, False), sizes.coarse_iterations, strict=True):
                height = sizes.start_view_height // (2 if coarse else 1)
                level = picture.canonical_level(height, sizes.contrast_share, blur=coarse)
                points = joined([queries[number].points_from_starts(part, coarse) for number, part in by_map(group)])
                group = self._refine(picture, level, points, group, iterations, sizes.coarse_stop, self._rough_step())
            refined += within_limits(queries, group)
        return refined

    def _refine_on_poses(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see, found anew in each round as what a pose sees changes with it."""
        sizes, refined = self.config.refinement, []
        for picture, group in by_colors(queries, hypotheses):
            for rows, scale in sizes.middle_rounds:
                points = joined([queries[number].points_from_poses(part) for number, part in by_map(group)])
                level = picture.canonical_level(rows, sizes.contrast_share)
                step = replace(self.config.step, robust_scale=scale)
                group = self._refine(picture, level, points, group, sizes.middle_iterations, sizes.middle_stop, step)
                group = within_limits(queries, group)
            refined += group
        return refined

    def _rough_step(self) -> StepConfig:
        """Return the steps from the starts."""
        sizes, step = self.config.refinement, self.config.step
        if sizes.rough_damping is None or sizes.rough_max_relaxation is None:
            return step
        return replace(step, damping=sizes.rough_damping, relaxation=1.0, max_relaxation=sizes.rough_max_relaxation)

    def _refine_fully(self, query: MapQuery, hypothesis: Hypothesis) -> Hypothesis:
        """Refine at full resolution, with all points and the colours of this pose alone."""
        self.clock.check()
        sizes, share = self.config.refinement, self.config.refinement.fine_contrast_share
        comparison = query.compare([hypothesis], sizes.visibility_height, with_points=True)
        for height, count, iterations in (
            (sizes.fine_height, sizes.fine_points, sizes.fine_iterations),
            (sizes.finest_height, sizes.finest_points, sizes.finest_iterations),
        ):
            points = query.full_points(hypothesis, comparison, count)
            level = query.picture.level_for(comparison, height, share)
            (hypothesis,) = self._refine(query.picture, level, points, [hypothesis], iterations, sizes.fine_stop)
        return query.within_limits(hypothesis)

    def _refine(
        self,
        picture: PreparedPanorama | PreparedPhotos,
        level: ImageLevel | RigLevel,
        points: CandidatePoints,
        group: Sequence[Hypothesis],
        iterations: int,
        stop: StoppingRule,
        step: StepConfig | None = None,
    ) -> list[Hypothesis]:
        """Refine hypotheses of maps that share colours; step: None for that of the configuration."""
        step = step or self.config.step
        if picture.labels is not None:
            step = step.for_labels()
        rotations, positions = stacked_poses(group)
        maps = torch.tensor([h.map_number for h in group], device=rotations.device)
        return with_refined(group, refine(level, points, rotations, positions, iterations, step, stop, maps))

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
