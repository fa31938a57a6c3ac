"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch

from core.config import LocalizerConfig, Rest
from core.index.map_index import MapIndex
from core.judge.agreement import agreement, judged_hypotheses
from core.judge.hypotheses import (
    ELSEWHERE_DEG,
    ELSEWHERE_M,
    Hypothesis,
    MethodResult,
    best_distinct,
    by_map,
    converged,
    promising,
    stacked_poses,
)
from core.options import Hints
from core.panorama.image_level import ImageLevel
from core.panorama.panorama import Panorama
from core.prepared_query import PreparedQuery
from core.refine.candidate_points import points_seen_from_poses
from core.refine.gauss_newton import StepRules
from core.refine.refinement import CandidatePoints, joined, refine
from core.search.map_search import SearchRotations, search_maps
from core.search.pose_limits import PoseLimits, pose_limits
from core.stage_clock import StageClock
from core.views.comparison import Comparison, compare
from core.views.render_cloud import RenderCloud
from core.views.synthetic_view import RENDER_BATCH


class FastMethod:
    """Holds what does not change between queries: configuration and rotations."""

    def __init__(self, config: LocalizerConfig, device: torch.device, rotations: SearchRotations) -> None:
        self.config, self.device, self.rotations = config, device, rotations

    def run(self, panorama: Panorama, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return hypotheses over all maps, best first; none when the hints leave nothing to search."""
        sizes = self.config.refinement
        limits = [pose_limits(hints, index) for index in maps]
        with clock.stage("prepare"):
            query = PreparedQuery(panorama, maps, sizes.finest_height, self.device)
        with clock.stage("search"):
            found, num_starts, num_poses = self._search(query, limits)
        with clock.stage("refine"):
            coarse = self._refine_coarse(query, found)
        with clock.stage("judge"):
            judged = best_distinct(self._judge(query, converged(coarse)), len(coarse))
            kept = promising(judged, sizes.middle_candidates, sizes.middle_margin)
        with clock.stage("refine"):
            middle = self._refine_middle(query, kept)
        with clock.stage("judge"):
            ranked = [h for h in best_distinct(self._judge(query, middle), len(middle)) if _allowed(h, limits)]
        with clock.stage("refine"):
            close = [h for h in ranked[: sizes.fine_candidates] if h.score >= ranked[0].score - sizes.fine_margin]
            fine, comparisons = self._refine_fine(query, close, clock)
        order = sorted((i for i, h in enumerate(fine) if _allowed(h, limits)), key=lambda i: -fine[i].score)
        best = comparisons[order[0]] if order else (None, None)
        hypotheses = [fine[i] for i in order] + ranked[len(close) :]
        with clock.stage("judge"):
            hypotheses = self._judge_rival(query, hypotheses, len(order))
        return MethodResult(hypotheses, best[0], best[1], num_starts, num_poses)

    def _judge_rival(self, query: PreparedQuery, hypotheses: list[Hypothesis], num_fine: int) -> list[Hypothesis]:
        """Judge the best candidate at another place on the larger rendering too: the margin must compare like with like."""
        height = self.config.judge.final_height
        for k, rival in enumerate(hypotheses):
            if num_fine and k and not rival.is_near(hypotheses[0], ELSEWHERE_M, ELSEWHERE_DEG):
                if k >= num_fine:
                    number = rival.map_number
                    final = self._compare(query, number, query.cloud(number), [rival], height, with_points=False)
                    hypotheses[k] = judged_hypotheses([rival], agreement(final, height))[0]
                break
        return hypotheses

    def _search(self, query: PreparedQuery, limits: Sequence[PoseLimits]) -> tuple[list[Hypothesis], int, int]:
        """Search every map and keep the best candidates over all of them."""
        config = self.config.search
        described = [query.described(number, config) for number in range(len(query.maps))]
        found = search_maps(described, query.maps, self.rotations, limits, config)
        poses = [
            (score, number, start, turn)
            for number, part in enumerate(found)
            for score, start, turn in zip(
                part.candidates.scores.tolist(),
                part.candidates.starts.tolist(),
                part.candidates.rotations.tolist(),
                strict=True,
            )
        ]
        poses.sort(key=lambda pose: -pose[0])
        hypotheses = [
            Hypothesis(number, start, found[number].rotations[turn], query.maps[number].starts[start])
            for _, number, start, turn in poses[: config.num_candidates]
        ]
        return hypotheses, sum(part.num_starts for part in found), sum(part.num_poses for part in found)

    def _refine_coarse(self, query: PreparedQuery, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on what the starts see, at 32 and 64 rows."""
        sizes = self.config.refinement
        refined: list[Hypothesis] = []
        for number, group in query.by_colors(hypotheses):
            for coarse, iterations in zip((True, False), sizes.coarse_iterations, strict=True):
                height = self.config.search.view_height // (2 if coarse else 1)
                level = query.canonical_level(number, height, sizes.contrast_share, blur=coarse)
                points = joined([query.points_from_starts(*part, self.config, coarse) for part in by_map(group)])
                group = self._refined(query, level, points, group, iterations, sizes.coarse_rest)
            refined += group
        return refined

    def _refine_middle(self, query: PreparedQuery, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see."""
        sizes, height = self.config.refinement, self.config.judge.height
        refined: list[Hypothesis] = []
        for number, group in query.by_colors(hypotheses):
            for rows, scale in sizes.middle_rounds:
                # Rendered anew each time: what a pose sees changes as it moves.
                points = joined([self._points_from_poses(query, *part, height) for part in by_map(group)])
                level = query.canonical_level(number, rows, sizes.contrast_share)
                group = self._refined(query, level, points, group, sizes.middle_iterations, sizes.middle_rest, scale)
            refined += group
        return refined

    def _points_from_poses(
        self, query: PreparedQuery, number: int, group: Sequence[Hypothesis], height: int
    ) -> CandidatePoints:
        """Return the points of one map that the poses themselves see, those that changed with a smaller weight."""
        cloud, sizes = query.cloud(number), self.config.refinement
        comparison = self._compare(query, number, cloud, group, height)
        return points_seen_from_poses(cloud, comparison, sizes.middle_points, sizes.contrast_share, weigh_changes=True)

    def _refine_fine(
        self, query: PreparedQuery, hypotheses: Sequence[Hypothesis], clock: StageClock
    ) -> tuple[list[Hypothesis], list[tuple[Comparison, RenderCloud]]]:
        """Refine one by one at full resolution with all points, and judge on a larger rendering."""
        sizes, judge = self.config.refinement, self.config.judge
        share = sizes.fine_contrast_share
        refined: list[Hypothesis] = []
        comparisons = []
        for hypothesis in hypotheses:
            clock.check()
            number = hypothesis.map_number
            cloud = query.cloud(number)
            comparison = self._compare(query, number, cloud, [hypothesis], sizes.visibility_height)
            group = [hypothesis]
            for height, count, iterations in (
                (sizes.fine_height, sizes.fine_points, sizes.fine_iterations),
                (sizes.finest_height, sizes.finest_points, sizes.finest_iterations),
            ):
                points = points_seen_from_poses(cloud, comparison, count, share, weigh_changes=False)
                level = query.level_for(number, height, comparison.tables, share)
                group = self._refined(query, level, points, group, iterations, sizes.fine_rest, sizes.fine_robust_scale)
            final = self._compare(query, number, cloud, group, judge.final_height, with_points=False)
            refined += judged_hypotheses(group, agreement(final, judge.final_height))
            comparisons.append((final, cloud))
        return refined, comparisons

    def _judge(self, query: PreparedQuery, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Render the scan at every pose and measure the agreement."""
        height, judged = self.config.judge.height, []
        for number, group in by_map(hypotheses):
            cloud = query.cloud(number)
            for first in range(0, len(group), RENDER_BATCH):
                part = group[first : first + RENDER_BATCH]
                comparison = self._compare(query, number, cloud, part, height, with_points=False)
                judged += judged_hypotheses(part, agreement(comparison, height))
        return judged

    def _compare(
        self,
        query: PreparedQuery,
        number: int,
        cloud: RenderCloud,
        group: Sequence[Hypothesis],
        height: int,
        with_points: bool = True,
    ) -> Comparison:
        rotations, positions = stacked_poses(group)
        level = query.pyramid(number).level(height)
        is_labels = query.maps[number].labels is not None
        return compare(cloud, level, rotations, positions, height, is_labels, with_points)

    def _refined(
        self,
        query: PreparedQuery,
        level: ImageLevel,
        points: CandidatePoints,
        group: Sequence[Hypothesis],
        iterations: int,
        rest: Rest,
        robust_scale: float | None = None,
    ) -> list[Hypothesis]:
        rotations, positions = stacked_poses(group)
        sizes = self.config.refinement
        is_labels = query.maps[group[0].map_number].labels is not None
        floor = sizes.min_residual_labels if is_labels else sizes.min_residual
        rules = StepRules(not is_labels, robust_scale or sizes.robust_scale, floor)
        maps = torch.tensor([h.map_number for h in group], device=rotations.device)
        result = refine(level, points, rotations, positions, iterations, rules, rest, maps)
        columns = (result.numbers, result.loss, result.scale, result.steps)
        figures = torch.stack([column.double() for column in columns], dim=1).tolist()
        return [
            replace(
                group[int(number)],
                rotation=result.rotations[k],
                position=result.positions[k],
                loss=loss,
                hessian=result.hessian[k],
                residual_scale=scale,
                iterations=group[int(number)].iterations + int(steps),
            )
            for k, (number, loss, scale, steps) in enumerate(figures)
        ]


def _allowed(hypothesis: Hypothesis, limits: Sequence[PoseLimits]) -> bool:
    limit = limits[hypothesis.map_number]
    return bool(limit.allows_position(hypothesis.position)) and bool(limit.allows_rotation(hypothesis.rotation))
