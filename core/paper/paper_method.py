"""The `paper` method: CPO (ECCV 2022) with its own parameters. The order of the steps is written here.

match colours to the cloud → synthetic views at N_t starts → patch histograms → intersection tensor → score maps 2D and 3D
→ K candidates → Adam on the weighted sampling loss → smallest loss wins.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from panoloc.core.camera.panorama import Panorama
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis, MethodResult
from panoloc.core.features.equalization import transport
from panoloc.core.features.patch_grid import PatchGrid, rotation_table
from panoloc.core.features.patch_histograms import hard_histograms
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.image.pyramid import PanoramaLevel, PanoramaPyramid
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.paper.intersection import bin_major, intersection_tensor
from panoloc.core.paper.sampling_loss import SamplingProblem, minimize_by_adam, sampling_loss
from panoloc.core.paper.score_maps import score_map_2d, score_map_3d, view_patch_scores
from panoloc.core.prepared_query import prepare_queries
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.search.pose_limits import PoseLimits, pose_limits
from panoloc.core.search.pose_scores import score_poses
from panoloc.core.stage_clock import StageClock


class PaperMethod:
    """Holds the parameters; every query renders its synthetic views anew, as the paper does."""

    def __init__(self, config: LocalizerConfig, device: torch.device) -> None:
        self.config, self.localizer_config, self.device = config.paper, config, device
        self.rotations = uniform_rotations(config.paper.num_rotations).to(device)

    def run(self, panorama: Panorama, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return the refined candidates of all maps, smallest loss first."""
        hypotheses: list[Hypothesis] = []
        num_starts = num_poses = 0
        for number, index in enumerate(maps):
            limits = pose_limits(hints, index)
            starts, rotations = self._searched(index, limits)
            if len(starts) == 0 or len(rotations) == 0:
                continue
            num_starts += len(starts)
            num_poses += len(starts) * len(rotations)
            found = self._localize_in(number, index, panorama, starts, rotations, clock)
            hypotheses += [h for h in found if limits.allows_pose(h.rotation, h.position)]
        hypotheses.sort(key=lambda h: h.loss)
        if not hypotheses:
            return MethodResult([], None, None, num_starts, num_poses)
        with clock.stage("judge"):  # which leaves the order that of the losses
            height = self.localizer_config.judge.final_height
            queries = prepare_queries(panorama, maps, hints, height, self.localizer_config)
            judged, comparisons = zip(*(queries[h.map_number].judge_alone(h) for h in hypotheses), strict=True)
        cloud = queries[hypotheses[0].map_number].cloud
        return MethodResult(list(judged), comparisons[0], cloud, num_starts, num_poses)

    def _searched(self, index: MapIndex, limits: PoseLimits) -> tuple[Tensor, Tensor]:
        """Return the starts (T, 3), N_t of the allowed ones evenly chosen, and the rotations (R, 3, 3)."""
        starts = index.starts[limits.searched_starts(index.starts, self.localizer_config.search.hint_margin_m)]
        count = min(self.config.num_starts, len(starts))
        chosen = torch.linspace(0, len(starts) - 1, count).round().long() if count else torch.zeros(0, dtype=torch.long)
        return starts[chosen.to(starts.device)], self.rotations[
            limits.searched_rotations(self.rotations, self.localizer_config.search.hint_margin_deg)
        ]

    def _localize_in(
        self, number: int, index: MapIndex, panorama: Panorama, starts: Tensor, rotations: Tensor, clock: StageClock
    ) -> list[Hypothesis]:
        config = self.config
        with clock.stage("color_matching"):
            colors = index.canonical_cloud_colors()
            pyramid = PanoramaPyramid(panorama, config.image_height, index.labels, self.device)
            query = self._matched(pyramid.level(config.image_height), colors, index)
        grid = PatchGrid(config.search_rows, config.search_columns)
        map_grid = PatchGrid(config.map_rows, config.map_columns)
        with clock.stage("search"):
            views = self._views(index, starts)
            tensor, table = self._tensor(query, views, grid, rotations)
            patch_scores, point_weights = self._score_maps(query, views, map_grid, rotations, index, starts)
        problem = SamplingProblem(
            query.color, query.valid, index.positions, colors, point_weights, patch_scores, map_grid
        )
        with clock.stage("candidates"):
            if config.initialize_by_histograms:
                weights = self._patch_weights(tensor, table, grid)
                scores = score_poses(tensor, table, weights)
            else:
                scores = -_losses_at(problem, starts, rotations, config.initial_loss_points)
            best = scores.flatten().topk(min(config.num_candidates, scores.numel()))
        found = []
        for flat in best.indices.tolist():
            start, turn = divmod(flat, len(rotations))
            with clock.stage("refine"):
                rotation, position, loss = minimize_by_adam(
                    problem, rotations[turn], starts[start], config, clock.check
                )
            model = "labels" if index.labels is not None else ("global_transport" if config.match_colors else "none")
            found.append(
                Hypothesis(
                    number, start, rotation, position, loss=loss, iterations=config.iterations, color_model=model
                )
            )
        return found

    def _matched(self, level: PanoramaLevel, colors: Tensor, index: MapIndex) -> PanoramaLevel:
        """Match the panorama's colours to the whole cloud's (§3.1); labels have none to match."""
        if index.labels is not None or not self.config.match_colors:
            return level
        flat = level.color.flatten(1).T
        matched = transport(flat, level.weights().flatten(), colors, torch.ones(len(colors), device=self.device))
        return PanoramaLevel(matched.T.reshape(level.color.shape), level.valid)

    def _views(self, index: MapIndex, starts: Tensor) -> tuple[Tensor, Tensor]:
        """Render all starts: colours (T, S, 3) and solid-angle weights (T, S)."""
        height = self.config.view_height
        solid = pixel_solid_angles(height, 2 * height, self.device).expand(-1, 2 * height).flatten()
        cloud = index.render_cloud
        rendered = [render_views(cloud, start[None], height) for start in starts]
        return torch.cat([v.color.flatten(1, 2) for v in rendered]), torch.cat(
            [v.valid.flatten(1) * solid for v in rendered]
        )

    def _tensor(
        self, query: PanoramaLevel, views: tuple[Tensor, Tensor], grid: PatchGrid, rotations: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the intersection tensor (T, P, P) on a patch grid, and the rotation table (R, P)."""
        bins, height = self.config.bins, self.config.view_height
        patch = grid.patch_of_pixel(height, 2 * height, self.device).flatten()
        histograms = hard_histograms(views[0], views[1], patch.expand(len(views[0]), -1), len(grid), bins)
        full_patch = grid.patch_of_pixel(query.height, 2 * query.height, self.device).flatten()[None]
        own = hard_histograms(
            query.color.flatten(1).T[None], query.weights().flatten()[None], full_patch, len(grid), bins
        )[0]
        return intersection_tensor(own, bin_major(histograms), len(histograms)), rotation_table(grid, rotations)

    def _score_maps(
        self,
        query: PanoramaLevel,
        views: tuple[Tensor, Tensor],
        grid: PatchGrid,
        rotations: Tensor,
        index: MapIndex,
        starts: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return M_2D (P,) and M_3D (N,), ones where an ablation or labels leave them out."""
        config = self.config
        ones = torch.ones(len(grid), device=self.device), torch.ones(index.num_points, device=self.device)
        if index.labels is not None or not (config.use_score_map_2d or config.use_score_map_3d):
            return ones
        tensor, table = self._tensor(query, views, grid, rotations)
        flat = score_map_2d(tensor, table) if config.use_score_map_2d else ones[0]
        if not config.use_score_map_3d:
            return flat, ones[1]
        return flat, score_map_3d(view_patch_scores(tensor, table), index.positions, starts, grid)

    def _patch_weights(self, tensor: Tensor, table: Tensor, grid: PatchGrid) -> Tensor:
        """Return ½ (M_i + S_i) (P,) of Eq. 4 with distortion handling (supplement)."""
        scores = (
            score_map_2d(tensor, table) if self.config.use_score_map_2d else torch.ones(len(grid), device=self.device)
        )
        return 0.5 * (scores + grid.polar_sines(self.device))


def _losses_at(problem: SamplingProblem, starts: Tensor, rotations: Tensor, max_points: int) -> Tensor:
    """Return the sampling loss (T, R) of every pose on a sample of the points (PICCOLO's initialization)."""
    stride = max(1, len(problem.positions) // max_points)
    sample = replace(
        problem,
        positions=problem.positions[::stride],
        colors=problem.colors[::stride],
        point_weights=problem.point_weights[::stride],
    )
    with torch.no_grad():
        rows = [torch.stack([sampling_loss(sample, rotation, start) for rotation in rotations]) for start in starts]
    return torch.stack(rows)
