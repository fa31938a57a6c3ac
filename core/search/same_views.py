"""Where the scan looks as it does from a place that was found: what the map itself tells of equal rooms, whatever a photo shows.

All that a scan shows around a place is far more than a photo of it shows: from equal and repeated rooms it scores like the place itself
as seen from a start beside it, from everywhere else in a building half as much (docs/experiments.md).
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from panoloc.core.config import LocalizerConfig, PhotoSearchConfig
from panoloc.core.features.patch_descriptors import centered_roots, pooled
from panoloc.core.features.patch_grid import PatchGrid, rotation_table
from panoloc.core.features.patch_histograms import described_histograms
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.map_index import MapIndex
from panoloc.core.render.described_view import views_to_describe
from panoloc.core.search.map_search import MapCandidates, scores_of_starts
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.pose_scores import Candidates


def search_same_views(
    own: MapIndex,
    rotation: Tensor,
    position: Tensor,
    maps: Sequence[tuple[MapIndex, PoseLimits]],
    config: LocalizerConfig,
) -> list[MapCandidates]:
    """Return, for each map, the starts from which it looks as `own` does from a pose of it, (3, 3) map_from_rig and (3,).

    Their rotations are that of the pose turned about the vertical: equal rooms stand upright. None is at the place of the pose itself.
    """
    search = config.photo_search
    angles = torch.arange(search.same_view_turns, device=position.device) * (2 * math.pi / search.same_view_turns)
    turns = rotation_from_vector(torch.nn.functional.pad(angles[:, None], (2, 0)))
    is_turned = torch.minimum(angles, 2 * math.pi - angles) > math.radians(search.same_view_turned_deg)
    view = _View(own, position, turns, config)
    is_beside = (own.starts - position).norm(dim=1) < config.search.elsewhere.distance_m
    beside = is_beside.nonzero()[:, 0]  # none where starts are farther apart than that
    reference = float(view.scores(own, beside)[:, ~is_turned].max()) if len(beside) else math.inf
    least = min(search.same_view_share * reference, search.same_view_least)
    found = []
    for index, limits in maps:
        allowed = limits.searched_starts(index.starts, search.limit_margin_m)
        allowed_turns = limits.allows_rotation(turns @ rotation, math.radians(search.limit_margin_deg))
        itself = (
            is_beside[:, None] & ~is_turned
            if index is own
            else torch.zeros(1, 1, dtype=torch.bool, device=turns.device)
        )
        excluded = itself | ~allowed[:, None] | ~allowed_turns
        coarse = view.coarse_scores(index).masked_fill(excluded, -math.inf).amax(1)
        count = max(search.same_view_starts, round(search.same_view_kept_share * len(coarse)))
        starts = coarse.topk(min(count, len(coarse))).indices
        scores = view.scores(index, starts).masked_fill(excluded[starts], -math.inf)
        found.append(_best(scores, starts, index, turns @ rotation, least, search))
    return found


class _View:
    """All that a map shows from a position (3,), in patches, ready to be held against starts under rotations (R, 3, 3)."""

    def __init__(self, own: MapIndex, position: Tensor, rotations: Tensor, config: LocalizerConfig) -> None:
        described, is_labels = config.descriptors, own.labels is not None
        grid = PatchGrid(described.patch_rows, described.patch_columns)
        view, _ = views_to_describe(own.render_cloud, position[None], described.view_height, is_labels)
        histograms = described_histograms(
            view.color, view.canonical, view.valid.float(), view.weights, grid, described.bins, is_labels
        )
        self.roots, self.weights = centered_roots(histograms, grid.solid_angles(position.device))
        self.table = rotation_table(grid, rotations)
        self.coarse_table = rotation_table(PatchGrid(grid.rows // 2, grid.columns // 2), rotations)

    def scores(self, index: MapIndex, starts: Tensor) -> Tensor:
        """Return the scores (T, R) of the starts numbered `starts` (T,) of a map."""
        query = self.roots[0] @ index.descriptors.basis
        return scores_of_starts(query, self.weights[0], index.descriptors, starts, self.table)

    def coarse_scores(self, index: MapIndex) -> Tensor:
        """Return scores (T, R) of all starts, by patches twice as large."""
        query, weights = pooled(self.roots @ index.descriptors.basis, self.weights)
        every = torch.arange(index.num_starts, device=query.device)
        return scores_of_starts(query[0], weights[0], index.coarse_views, every, self.coarse_table)


def _best(
    scores: Tensor, starts: Tensor, index: MapIndex, rotations: Tensor, least: float, search: PhotoSearchConfig
) -> MapCandidates:
    """Return the best of the scores (T, R) of starts (T,) that are no less than `least`, at places of their own."""
    score, turn = scores.max(dim=1)
    kept = (score >= least).nonzero()[:, 0]
    kept = kept[score[kept].argsort(descending=True)]
    distinct = first_distinct(
        rotations[turn[kept]], index.starts[starts[kept]], search.distinct, count=search.same_views
    )
    chosen = kept[torch.tensor(distinct, dtype=torch.long, device=kept.device)]
    return MapCandidates(
        Candidates(starts[chosen], turn[chosen], score[chosen]), rotations, index.num_starts, scores.numel()
    )
