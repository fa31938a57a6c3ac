"""The `paper` method: CPO (ECCV 2022) with its own parameters. The order of the steps is written here.

match colours to the cloud → synthetic views at N_t starts → patch histograms → intersection tensor → score maps 2D and 3D
→ K candidates → Adam on the weighted sampling loss → smallest loss wins.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis, MethodResult
from panoloc.core.features.patch_histograms import PatchGrid
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.rotations import rotation_spacing, uniform_rotations
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.paper.color_matching import transport
from panoloc.core.paper.intersection import bin_major, hard_histograms, intersection_tensor, rotation_table
from panoloc.core.paper.sampling_loss import SamplingProblem, minimize_by_adam, sampling_loss
from panoloc.core.paper.score_maps import score_map_2d, score_map_3d, view_patch_scores
from panoloc.core.paper.sphere_image import SphereImage
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.stage_clock import StageClock


class PaperMethod:
    """Holds the parameters; every query renders its synthetic views anew, as the paper does."""

    def __init__(self, config: LocalizerConfig, device: torch.device) -> None:
        self.config, self.localizer_config, self.device = config.paper, config, device
        self.rotations = uniform_rotations(config.paper.num_rotations).to(device)

    def run(self, rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, clock: StageClock) -> MethodResult:
        """Return the refined candidates of all maps, smallest loss first."""
        queries = prepare_queries(rig, maps, hints, self.localizer_config)
        sphere = rig_on_sphere(rig)
        hypotheses: list[Hypothesis] = []
        num_starts = num_poses = 0
        for query in queries:
            starts, rotations = self._searched(query.index, query.limits)
            if len(starts) == 0 or len(rotations) == 0:
                continue
            num_starts += len(starts)
            num_poses += len(starts) * len(rotations)
            found = self._localize_in(query, sphere, starts, rotations, clock)
            hypotheses += [h for h in found if query.allows(h)]
        hypotheses.sort(key=lambda h: h.loss)
        if not hypotheses:
            return MethodResult([], None, num_starts, num_poses, self.config.num_rotations)
        with clock.stage("judge"):  # which leaves the order that of the losses
            judged, comparisons = zip(*(queries[h.map_number].judge_alone(h) for h in hypotheses), strict=True)
        return MethodResult(list(judged), comparisons[0], num_starts, num_poses, self.config.num_rotations)

    def _searched(self, index: MapIndex, limits: PoseLimits) -> tuple[Tensor, Tensor]:
        """Return the starts (T, 3), N_t of the allowed ones evenly chosen, and the rotations (R, 3, 3)."""
        starts = index.starts[limits.searched_starts(index)]
        count = min(self.config.num_starts, len(starts))
        chosen = torch.linspace(0, len(starts) - 1, count).round().long() if count else torch.zeros(0, dtype=torch.long)
        allowed = limits.allows_rotation(self.rotations, rotation_spacing(len(self.rotations)) / 2)
        return starts[chosen.to(starts.device)], self.rotations[allowed]

    def _localize_in(
        self, searched: MapQuery, panorama: Panorama, starts: Tensor, rotations: Tensor, clock: StageClock
    ) -> list[Hypothesis]:
        config, index = self.config, searched.index
        with clock.stage("color_matching"):
            colors = index.canonical_cloud_colors()
            image = SphereImage.of_panorama(panorama, config.image_height, index.labels, self.device)
            query = self._matched(image, colors, index)
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
                    searched.number,
                    start,
                    rotation,
                    position,
                    loss=loss,
                    iterations=config.iterations,
                    color_model=model,
                )
            )
        return found

    def _matched(self, level: SphereImage, colors: Tensor, index: MapIndex) -> SphereImage:
        """Match the panorama's colours to the whole cloud's (§3.1); labels have none to match."""
        if index.labels is not None or not self.config.match_colors:
            return level
        flat = level.color.flatten(1).T
        matched = transport(flat, level.weights().flatten(), colors)
        return SphereImage(matched.T.reshape(level.color.shape), level.valid)

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
        self, query: SphereImage, views: tuple[Tensor, Tensor], grid: PatchGrid, rotations: Tensor
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
        query: SphereImage,
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
        x, y, _ = grid.centers(self.device).unbind(-1)
        # S is the sine of the polar angle of each centre, the share of a full-width row (supplement).
        return 0.5 * (scores + torch.hypot(x, y))


def score_poses(tensor: Tensor, table: Tensor, weights: Tensor) -> Tensor:
    """Return w (T, R): for each start and rotation the weighted sum over query patches of I[t, i, π_r(i)] (§3.3, Eq. 4).

    tensor: I (T, P, P), query patch first. table: π (R, P) of `rotation_table`. weights: (P,).
    """
    num_views, num_patches, _ = tensor.shape
    rows = tensor.permute(1, 2, 0).reshape(-1, num_views)
    index = table + torch.arange(num_patches, device=table.device) * num_patches
    scores = torch.nn.functional.embedding_bag(
        index, rows, mode="sum", per_sample_weights=weights.expand(len(table), -1).contiguous()
    )
    return scores.T


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
