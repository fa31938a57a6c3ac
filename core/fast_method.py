"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from core.config import LocalizerConfig, StoppingRule
from core.describe.spherical_patches import PatchGrid
from core.index.map_index import MapIndex
from core.judge.hypotheses import (
    Hypothesis,
    MethodResult,
    by_map,
    by_score,
    merged,
    stacked_poses,
    with_refined,
    within_margin,
)
from core.options import Hints
from core.panorama.image_level import ImageLevel
from core.panorama.panorama import Panorama
from core.prepared_query import MapQuery, PreparedPanorama, by_colors, prepare_queries
from core.refine.candidate_points import points_seen_from_poses
from core.refine.refinement import CandidatePoints, joined, refine
from core.search.map_search import MapCandidates, make_search_rotations, search_maps
from core.stage_clock import StageClock


class FastMethod:
    """Holds what does not change between queries: configuration and rotations."""

    def __init__(self, config: LocalizerConfig, device: torch.device) -> None:
        self.config = config
        grid = PatchGrid(config.descriptors.patch_rows, config.descriptors.patch_columns)
        self.rotations = make_search_rotations(config.search, grid, device)

    def run(self, panorama: Panorama, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return hypotheses over all maps, best first; none when the hints leave nothing to search."""
        sizes, judge = self.config.refinement, self.config.judge
        with clock.stage("prepare"):
            queries = prepare_queries(panorama, maps, hints, sizes.finest_height, self.config)
        with clock.stage("search"):
            found = self._search(queries)
            hypotheses = self._candidates(queries, found)
        with clock.stage("refine"):
            hypotheses = self._refine_on_starts(queries, hypotheses)
        with clock.stage("judge"):
            hypotheses = self._judge(queries, merged(hypotheses, judge.merged))
            hypotheses = within_margin(hypotheses, sizes.middle_candidates, sizes.middle_margin, judge.place)
        with clock.stage("refine"):
            hypotheses = self._refine_on_poses(queries, hypotheses)
        with clock.stage("judge"):
            hypotheses = [h for h in self._judge(queries, hypotheses) if queries[h.map_number].allows(h)]
        with clock.stage("refine"):
            close = within_margin(hypotheses, sizes.fine_candidates, sizes.fine_margin)
            fine = [self._refine_fully(queries[h.map_number], h, clock) for h in close]
        with clock.stage("judge"):
            allowed = [queries[h.map_number].judge_alone(h) for h in fine if queries[h.map_number].allows(h)]
            finals = sorted(allowed, key=lambda final: -final[0].score)
            best = [h for h, _ in finals]
            others = self._judge_rival(queries, best, hypotheses[len(close) :])
        comparison = finals[0][1] if finals else None
        cloud = queries[best[0].map_number].cloud if best else None
        num_starts, num_poses = sum(part.num_starts for part in found), sum(part.num_poses for part in found)
        return MethodResult([*best, *others], comparison, cloud, num_starts, num_poses)

    def _search(self, queries: Sequence[MapQuery]) -> list[MapCandidates]:
        """Search every map."""
        described = [query.panorama.described(self.config.descriptors) for query in queries]
        maps, limits = [query.index for query in queries], [query.limits for query in queries]
        return search_maps(described, maps, self.rotations, limits, self.config.search)

    def _candidates(self, queries: Sequence[MapQuery], found: Sequence[MapCandidates]) -> list[Hypothesis]:
        """Return the best candidates over all maps."""
        hypotheses = []
        for query, part in zip(queries, found, strict=True):
            columns = part.candidates.scores, part.candidates.starts, part.candidates.rotations
            for score, start, turn in zip(*(column.tolist() for column in columns), strict=True):
                pose = part.rotations[turn], query.index.starts[start]
                hypotheses.append((score, Hypothesis(query.number, start, *pose)))
        hypotheses.sort(key=lambda scored: -scored[0])
        return [hypothesis for _, hypothesis in hypotheses[: self.config.search.num_candidates]]

    def _refine_on_starts(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on what the starts see, at half the rows of a view and at all of them."""
        sizes, refined = self.config.refinement, []
        for panorama, group in by_colors(queries, hypotheses):
            for coarse, iterations in zip((True, False), sizes.coarse_iterations, strict=True):
                height = self.config.descriptors.view_height // (2 if coarse else 1)
                level = panorama.canonical_level(height, sizes.contrast_share, blur=coarse)
                points = joined([queries[number].points_from_starts(part, coarse) for number, part in by_map(group)])
                group = self._refine(panorama, level, points, group, iterations, sizes.coarse_stop)
            refined += group
        return refined

    def _refine_on_poses(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see, found anew in each round as what a pose sees changes with it."""
        sizes, refined = self.config.refinement, []
        for panorama, group in by_colors(queries, hypotheses):
            for rows, scale in sizes.middle_rounds:
                points = joined([queries[number].points_from_poses(part) for number, part in by_map(group)])
                level = panorama.canonical_level(rows, sizes.contrast_share)
                limits = sizes.middle_iterations, sizes.middle_stop
                group = self._refine(panorama, level, points, group, *limits, robust_scale=scale)
            refined += group
        return refined

    def _refine_fully(self, query: MapQuery, hypothesis: Hypothesis, clock: StageClock) -> Hypothesis:
        """Refine at full resolution, with all points and the colours of this pose alone."""
        clock.check()
        sizes, share = self.config.refinement, self.config.refinement.fine_contrast_share
        comparison = query.compare([hypothesis], sizes.visibility_height, with_points=True)
        for height, count, iterations in (
            (sizes.fine_height, sizes.fine_points, sizes.fine_iterations),
            (sizes.finest_height, sizes.finest_points, sizes.finest_iterations),
        ):
            points = points_seen_from_poses(query.cloud, comparison, count, share)
            level = query.panorama.level_for(comparison, height, share)
            (hypothesis,) = self._refine(query.panorama, level, points, [hypothesis], iterations, sizes.fine_stop)
        return hypothesis

    def _refine(
        self,
        panorama: PreparedPanorama,
        level: ImageLevel,
        points: CandidatePoints,
        group: Sequence[Hypothesis],
        iterations: int,
        stop: StoppingRule,
        robust_scale: float | None = None,
    ) -> list[Hypothesis]:
        """Refine hypotheses of maps that share colours; robust_scale: None for that of the configuration."""
        step = self.config.step if panorama.labels is None else self.config.step.for_labels()
        if robust_scale is not None:
            step = replace(step, robust_scale=robust_scale)
        rotations, positions = stacked_poses(group)
        maps = torch.tensor([h.map_number for h in group], device=rotations.device)
        return with_refined(group, refine(level, points, rotations, positions, iterations, step, stop, maps))

    def _judge(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses by falling score, one for each pose."""
        height = self.config.judge.height
        judged = [h for number, group in by_map(hypotheses) for h in queries[number].judge(group, height)]
        return by_score(judged, self.config.judge.distinct)

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
