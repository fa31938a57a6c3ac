"""The search of one round: every start that the limits leave with every rotation, for all maps of a query.

Histograms of patches propose poses; the small pictures of the views are then held against the best of them pixel by pixel, both sides
equalized over what the images show. What patches say counts a little there, too. Where lines of the images say how the rig is turned, few
rotations are left, and every pose is scored by pixels.

Paper: §3.3 (all starts with all rotations).
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, SearchConfig
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.patch_descriptors import DescribedPatches, patch_scores
from panoloc.core.geometry.rotations import rotation_spacing, rotations_of
from panoloc.core.kernels.library import call, has_kernels_for, num_threads
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.candidates import Candidates, MapCandidates
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.every_pose import scores_of_every_pose
from panoloc.core.search.line_evidence import LineEvidence
from panoloc.core.search.pixel_scores import pixel_scores
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.position_sweep import swept

Found = TypeVar("Found")


class MapSearch:
    """One map of a query, ready to be searched.

    lines: what the edges of the images say of rotations; None where that is little.
    """

    def __init__(
        self, rig: DescribedRig, index: MapIndex, lines: LineEvidence | None, is_wide: bool, config: SearchConfig
    ) -> None:
        self.rig, self.index, self.lines, self.is_wide, self.config = rig, index, lines, is_wide, config

    def starts(self, limits: PoseLimits) -> Tensor:
        """Return the numbers (T,) of the starts that limits leave."""
        return limits.searched_starts(self.index).nonzero()[:, 0]

    def first_scores(self, limits: PoseLimits) -> Tensor:
        """Return the score (T,) of each start that limits leave under its best rotation, by the largest patches."""
        starts, rotations = self.starts(limits), self._rotations(2, limits)
        if not len(starts) or not len(rotations):
            return torch.full((len(starts),), torch.inf, device=starts.device)
        patches = self.rig.patches(self.index.views.basis, 2)
        return patch_scores(patches, self.index.views.descriptors(2).take(starts), rotations).amax(1)

    def propose(
        self,
        limits: PoseLimits,
        starts: Tensor,
        by_lines: bool,
        count: int,
    ) -> MapCandidates:
        """Return the best `count` poses at the starts (T,) within limits, none near one before it.

        by_lines: only of rotations that lines agree with, where they are asked.
        """
        if by_lines and self.lines is not None:
            return self._by_lines(self.lines, limits, starts, count)
        halvings = self.config.halvings(self.is_wide)
        rotations = self._rotations(halvings, limits)
        if not len(starts) or not len(rotations):
            return self._nothing(starts)
        patches = self.rig.patches(self.index.views.basis, halvings)
        scores = patch_scores(patches, self.index.views.descriptors(halvings).take(starts), rotations)
        most = max(count, self.config.rescored_pixels // max(1, len(self.rig.pixels)))
        best = scores.flatten().topk(min(most, scores.numel())).indices
        start, rotation = best // len(rotations), best % len(rotations)
        by_patches = self.config.histogram_weight * scores.flatten()[best]
        found = self._rescored(self._views(starts), starts, rotations, start, rotation, by_patches)
        found = found.ranked(found.scores, DISTANCES.place, count, self.config.pool)
        return MapCandidates(found, len(starts), scores.numel())

    def _by_lines(
        self,
        lines: LineEvidence,
        limits: PoseLimits,
        starts: Tensor,
        count: int,
    ) -> MapCandidates:
        """Score the starts with the few rotations that lines leave, and the best at places around their starts as well."""
        config = self.config
        rotations = lines.likely_rotations(limits)
        if not len(starts) or not len(rotations):
            return self._nothing(starts)
        views = self._views(starts)
        scores = scores_of_every_pose(self.rig.pixels, views, rotations, self._is_labels)
        best = scores.flatten().topk(min(config.pool, scores.numel())).indices
        start, rotation = best // len(rotations), best % len(rotations)
        by_patches = (
            2
            * config.histogram_weight
            * patch_scores_of(self.rig.patches(self.index.views.basis), views, rotations, start, rotation)
        )
        most = max(1, config.rescored_pixels // max(1, len(self.rig.pixels)))
        again = (scores.flatten()[best] + by_patches).topk(min(most, len(best))).indices
        found = self._rescored(views, starts, rotations, start[again], rotation[again], by_patches[again])
        found = found.ranked(found.scores, DISTANCES.place, config.pool, config.pool)
        return MapCandidates(swept(self.rig, self.index, found, count, config), len(starts), scores.numel())

    def _rescored(
        self,
        views: DescribedViews,
        starts: Tensor,
        rotations: Tensor,
        start: Tensor,
        rotation: Tensor,
        by_patches: Tensor,
    ) -> Candidates:
        """Return poses, numbers (K,) of starts and rotations, with their scores by pixels and by patches (K,)."""
        scores = pixel_scores(self.rig.pixels, views, rotations, start, rotation, self._is_labels)
        numbers = starts[start]
        return Candidates(numbers, rotations[rotation], self.index.starts[numbers], scores + by_patches, by_patches)

    def _rotations(self, halvings: int, limits: PoseLimits) -> Tensor:
        count = self.config.rotations_with(halvings)
        every = rotations_of(count, str(self.index.starts.device))
        allowed = limits.allows_rotation(every, rotation_spacing(count) / 2)
        return every if bool(allowed.all()) else every[allowed]

    @property
    def _is_labels(self) -> bool:
        return self.index.labels is not None

    def _views(self, starts: Tensor) -> DescribedViews:
        return self.index.views if len(starts) == self.index.num_starts else self.index.views.take(starts)

    def _nothing(self, starts: Tensor) -> MapCandidates:
        none = self.index.starts[:0]
        empty = Candidates(starts[:0], none.new_zeros((0, 3, 3)), none, none[:, 0], none[:, 0])
        return MapCandidates(empty, len(starts), 0)


def search_maps(
    searches: Sequence[MapSearch], limits: Sequence[PoseLimits], by_lines: bool, config: SearchConfig
) -> list[MapCandidates]:
    """Propose poses in every map; searches and limits go together. Wide rigs look only at the starts that a first pass likes best over all
    maps."""
    starts = [search.starts(limit) for search, limit in zip(searches, limits, strict=True)]
    total = sum(map(len, starts))
    kept = math.ceil(config.kept_share * total)
    counts = list(map(len, starts))
    if searches[0].is_wide and kept < total:
        scores = _in_each(lambda search, limit: search.first_scores(limit), searches, limits)
        least = torch.cat(scores).topk(kept).values[-1]
        starts = [some[score >= least] for some, score in zip(starts, scores, strict=True)]
    found = _in_each(
        lambda search, limit, some: search.propose(limit, some, by_lines, config.num_candidates),
        searches,
        limits,
        starts,
    )
    return [MapCandidates(part.candidates, count, part.num_poses) for part, count in zip(found, counts, strict=True)]


def _in_each(work: Callable[..., Found], *columns: Sequence[Any]) -> list[Found]:
    """Return what is found in each map; several maps are searched at once."""
    at_once = min(len(columns[0]), num_threads())
    if at_once == 1:
        return [work(*of_map) for of_map in zip(*columns, strict=True)]
    with ThreadPoolExecutor(at_once) as threads:
        return list(threads.map(torch.inference_mode()(work), *columns))  # a mode of each thread


def patch_scores_of(
    patches: DescribedPatches, views: DescribedViews, rotations: Tensor, start: Tensor, rotation: Tensor
) -> Tensor:
    """Return the scores (K,) of some poses alone, the views numbered `start` (K,) with the rotations numbered `rotation` (K,).

    As those of `patch_scores`, without the similarity of patches that none of them puts on each other.
    """
    own = patches.values  # (Q, D)
    weighted = own * patches.weights[:, None]
    # Σ w (q · v)² over patches of the images and of the view.
    variance = (views.spreads * (own.T @ weighted)).sum((1, 2))
    if has_kernels_for(weighted):
        sums, towards = own.new_empty(len(start)), patches.towards(rotations)
        shown = views.steps, len(patches.grid), towards
        call("products_of_patches", weighted, *weighted.shape, *shown, len(start), start, rotation, sums)
        return sums * views.scale[start] / variance[start].clamp_min(1e-18).sqrt()
    towards = patches.towards(rotations)[rotation]  # (K, Q)
    met = views.steps.flatten(0, 1).index_select(0, (start[:, None] * len(patches.grid) + towards).flatten())
    met = met.view(len(start), -1).float()
    return met @ weighted.flatten() * views.scale[start] / variance[start].clamp_min(1e-18).sqrt()
