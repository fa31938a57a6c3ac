"""The `fast` method. The order of the steps is written here and nowhere else:

search all starts and rotations → refine coarsely on what the start sees → judge → refine on what the pose sees → judge
→ refine at full resolution → judge.

Each judgement discards candidates, so that the costly steps see few of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from core.candidate_points import (
    Comparison,
    compare,
    points_seen_from_poses,
    points_seen_from_starts,
)
from core.config import LocalizerConfig
from core.gauss_newton import CandidatePoints, ImageLevel, RefinementSteps, prepare_level, refine
from core.hypotheses import (
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
from core.judge import agreement, judged_hypotheses
from core.map_index import MapIndex
from core.panorama import Panorama
from core.panorama_pyramid import PanoramaLevel, PanoramaPyramid
from core.pose_limits import PoseLimits, pose_limits
from core.projection import wrap_border
from core.results import Hints
from core.search import RotationSet, search_map
from core.stage_clock import StageClock
from core.synthetic_view import RenderCloud

_RENDER_BATCH = 8  # views rendered at once: memory stays below 200 MB


class FastMethod:
    """Holds what does not change between queries: configuration and rotations."""

    def __init__(self, config: LocalizerConfig, device: torch.device, rotation_set: RotationSet) -> None:
        self.config, self.device, self.rotation_set = config, device, rotation_set

    def run(self, panorama: Panorama, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return hypotheses over all maps, best first; none when the hints leave nothing to search."""
        sizes = self.config.refinement
        limits = [pose_limits(hints, index) for index in maps]
        with clock.stage("prepare"):
            query = _Query(panorama, maps, sizes.finest_height, self.device)
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

    def _judge_rival(self, query: "_Query", hypotheses: list[Hypothesis], num_fine: int) -> list[Hypothesis]:
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

    def _search(self, query: "_Query", limits: Sequence[PoseLimits]) -> tuple[list[Hypothesis], int, int]:
        """Search every map and keep the best candidates over all of them."""
        found: list[Hypothesis] = []
        num_starts = num_poses = 0
        for number, (index, limit) in enumerate(zip(query.maps, limits, strict=True)):
            candidates, allowed, searched = search_map(
                query.pyramid(number), index, self.rotation_set, limit, self.config.search
            )
            num_starts += searched
            num_poses += searched * len(allowed.rotations)
            rows = zip(
                candidates.starts.tolist(), candidates.rotations.tolist(), candidates.scores.tolist(), strict=True
            )
            found += [
                Hypothesis(number, start, allowed.rotations[turn], index.starts[start], score)
                for start, turn, score in rows
            ]
        found.sort(key=lambda h: -h.search_score)
        return found[: self.config.search.num_candidates], num_starts, num_poses

    def _refine_coarse(self, query: "_Query", hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on the stored points of the starts, at 32 and 64 rows."""
        sizes = self.config.refinement
        refined: list[Hypothesis] = []
        for number, group in by_map(hypotheses):
            starts = torch.tensor([h.start for h in group], device=self.device)
            for coarse, iterations in zip((True, False), sizes.coarse_iterations, strict=True):
                height = self.config.search.view_height // (2 if coarse else 1)
                points = points_seen_from_starts(query.maps[number], starts, coarse)
                group = self._refined(
                    query, query.canonical_level(number, height, blur=coarse), points, group, iterations
                )
            refined += group
        return refined

    def _refine_middle(self, query: "_Query", hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see."""
        sizes, height = self.config.refinement, self.config.judge.height
        refined: list[Hypothesis] = []
        for number, group in by_map(hypotheses):
            cloud = query.cloud(number)
            for rows, scale in sizes.middle_rounds:
                # Rendered anew each time: what a pose sees changes as it moves.
                comparison = self._compare(query, number, cloud, group, height)
                points = points_seen_from_poses(cloud, comparison, sizes.middle_points, weigh_changes=True)
                level = query.canonical_level(number, rows)
                group = self._refined(query, level, points, group, sizes.middle_iterations, scale)
            refined += group
        return refined

    def _refine_fine(
        self, query: "_Query", hypotheses: Sequence[Hypothesis], clock: StageClock
    ) -> tuple[list[Hypothesis], list[tuple[Comparison, RenderCloud]]]:
        """Refine one by one at full resolution with all points, and judge on a larger rendering."""
        sizes, judge = self.config.refinement, self.config.judge
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
                points = points_seen_from_poses(cloud, comparison, count, weigh_changes=False)
                level = query.level_for(number, height, comparison.tables)
                group = self._refined(query, level, points, group, iterations, sizes.fine_robust_scale)
            final = self._compare(query, number, cloud, group, judge.final_height, with_points=False)
            refined += judged_hypotheses(group, agreement(final, judge.final_height))
            comparisons.append((final, cloud))
        return refined, comparisons

    def _judge(self, query: "_Query", hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Render the scan at every pose and measure the agreement."""
        height, judged = self.config.judge.height, []
        for number, group in by_map(hypotheses):
            cloud = query.cloud(number)
            for first in range(0, len(group), _RENDER_BATCH):
                part = group[first : first + _RENDER_BATCH]
                comparison = self._compare(query, number, cloud, part, height, with_points=False)
                judged += judged_hypotheses(part, agreement(comparison, height))
        return judged

    def _compare(
        self,
        query: "_Query",
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
        query: "_Query",
        level: ImageLevel,
        points: CandidatePoints,
        group: Sequence[Hypothesis],
        iterations: int,
        robust_scale: float | None = None,
    ) -> list[Hypothesis]:
        rotations, positions = stacked_poses(group)
        sizes = self.config.refinement
        is_labels = query.maps[group[0].map_number].labels is not None
        floor = sizes.min_residual_labels if is_labels else sizes.min_residual
        steps = RefinementSteps(iterations, not is_labels, robust_scale or sizes.robust_scale, floor)
        result = refine(level, points, rotations, positions, steps)
        losses, scales, counts = result.loss.tolist(), result.scale.tolist(), result.num_points.tolist()
        return [
            replace(
                h,
                rotation=result.rotations[k],
                position=result.positions[k],
                loss=losses[k],
                hessian=result.hessian[k],
                residual_scale=scales[k],
                num_points=int(counts[k]),
                iterations=h.iterations + iterations,
            )
            for k, h in enumerate(group)
        ]


class _Query:
    """The panorama's levels, prepared once for all maps that share their colours (all but those of labels)."""

    def __init__(self, panorama: Panorama, maps: Sequence[MapIndex], max_height: int, device: torch.device) -> None:
        self.maps = maps
        shared = PanoramaPyramid(panorama, max_height, None, device) if any(m.labels is None for m in maps) else None
        self._pyramids = [
            shared
            if m.labels is None and shared is not None
            else PanoramaPyramid(panorama, max_height, m.labels, device)
            for m in maps
        ]
        self._levels: dict[tuple[int, int, bool], ImageLevel] = {}

    def pyramid(self, number: int) -> PanoramaPyramid:
        """Return the pyramid for the map with this number."""
        return self._pyramids[number]

    def cloud(self, number: int) -> RenderCloud:
        """Return the cloud of a map, ready for rendering."""
        return self.maps[number].render_cloud

    def canonical_level(self, number: int, height: int, blur: bool = False) -> ImageLevel:
        """Return a level equalized over the whole panorama, prepared for sampling; blurred for the widest basin."""
        pyramid = self._pyramids[number]
        key = (id(pyramid), height, blur)
        if key not in self._levels:
            level = pyramid.level(height)
            color = level.canonical(self.maps[number].labels)
            self._levels[key] = prepare_level(_blur(color, level.valid) if blur else color, level.valid)
        return self._levels[key]

    def level_for(self, number: int, height: int, tables: Tensor | None) -> ImageLevel:
        """Return a level with the colours of one candidate: its own equalization (1, 3, 256), or label codes."""
        level: PanoramaLevel = self._pyramids[number].level(height)
        return prepare_level(level.color if tables is None else level.recolored(tables[0]), level.valid)


def _allowed(hypothesis: Hypothesis, limits: Sequence[PoseLimits]) -> bool:
    limit = limits[hypothesis.map_number]
    return bool(limit.allows_position(hypothesis.position)) and bool(limit.allows_rotation(hypothesis.rotation))


def _blur(color: Tensor, valid: Tensor) -> Tensor:
    """Smooth (3, H, W) over valid pixels (H, W) with the kernel 1 2 1 along both axes, around the seam and over the poles."""
    padded = wrap_border(torch.cat((color * valid, valid[None])))
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    total = rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]
    return total[:3] / total[3:].clamp_min(1.0)
