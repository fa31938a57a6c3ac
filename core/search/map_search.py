"""The search of one round: every start that the limits leave with every rotation, for all maps of a query.

Histograms of patches propose poses; the small pictures of the views are then held against the best of them pixel by pixel, both sides
equalized over what the images show. What patches say counts a little there, too. Where lines of the images say how the rig is turned, few
rotations are left, and every pose is scored by pixels.

Paper: §3.3 (all starts with all rotations).
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, TypeVar

import torch
from torch import Tensor

from panoloc.core.config import PoseDistance, SearchConfig
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.line_support import LineSupport
from panoloc.core.features.patch_descriptors import DescribedPatches, patch_scores
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_spacing, rotations_by_axes, rotations_of
from panoloc.core.kernels.library import call, has_kernels_for, num_threads
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.pixel_scores import pixel_scores, scores_of_every_pose
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.position_sweep import Candidates, swept

Found = TypeVar("Found")


class LineEvidence:
    """Edges of photos against the walls of a map.

    contrast: by how much edges agree better with the best rotation, of those that the limits allow where they bound the tilt, than with
    rotations by chance: mean logarithm of the likelihood ratio of an edge. What is dense enough is 3.5 degrees apart.
    """

    def __init__(self, lines: LineSupport, axes_from_map: Tensor, limits: PoseLimits, config: SearchConfig) -> None:
        self._lines, self._axes_from_map, self._config = lines, axes_from_map, config
        if limits.leaves_tilts_beyond(math.pi / 2):
            best = lines.of_axes(config.line_rotations).max()
        else:
            allowed = self._of_every[limits.allows_rotation(self._every)]
            best = allowed.max() if len(allowed) else torch.tensor(lines.by_chance)
        self.contrast = float(best) - lines.by_chance

    @cached_property
    def _every(self) -> Tensor:
        """Return rotations (N, 3, 3) map_from_rig, of which one is near any."""
        every = rotations_by_axes(self._config.line_rotations, str(self._axes_from_map.device))
        return torch.einsum("ba,nbc->nac", self._axes_from_map, every)

    @cached_property
    def _of_every(self) -> Tensor:
        """Return what `of_rotations` returns (N,) of them. Axes at right angles are the same after each of 24 turns."""
        of_axes = self._lines.of_axes(self._config.line_rotations)
        return of_axes.repeat(len(self._every) // len(of_axes))

    def of_rotations(self, rotations: Tensor) -> Tensor:
        """Return how well edges agree with rotations (R, 3, 3) map_from_rig: the mean logarithm of the likelihood ratio (R,)."""
        return self._lines.of_rotations(self._axes_from_map @ rotations)

    def missed(self, rotations: Tensor) -> Tensor:
        """Return how far rotations (R, 3, 3) fall short of the best one: 0, not at all, to 1, no better than by chance."""
        return 1 - ((self.of_rotations(rotations) - self._lines.by_chance) / max(self.contrast, 1e-6)).clamp(0, 1)

    def likely_rotations(self, limits: PoseLimits, most: int) -> Tensor:
        """Return the rotations (L, 3, 3) within the limits that edges agree with best, some degrees apart; of no more than `most`."""
        allowed = limits.allows_rotation(self._every, rotation_spacing(len(self._every)) / 2).nonzero()[:, 0]
        best = self._every[allowed[self._of_every[allowed].topk(min(len(allowed), most)).indices]]
        apart = PoseDistance(1.0, self._config.likely_apart_deg)
        distinct = first_distinct(best, torch.zeros_like(best[:, 0]), apart)
        return best[torch.tensor(distinct, dtype=torch.long, device=best.device)]


class MapSearch:
    """One map of a query, ready to be searched."""

    def __init__(self, rig: DescribedRig, index: MapIndex, is_wide: bool, config: SearchConfig) -> None:
        self.rig, self.index, self.is_wide, self.config = rig, index, is_wide, config

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
        self, limits: PoseLimits, starts: Tensor, lines: LineEvidence | None, count: int
    ) -> tuple[Candidates, int]:
        """Return the best `count` poses at the starts (T,) within limits, none near one before it, and how many were scored.

        lines: what the edges of the images say; then only of the few rotations that they agree with, and the best at places around their
        starts as well.
        """
        config = self.config
        if lines is None:
            halvings = config.halvings(self.is_wide)
            rotations = self._rotations(halvings, limits)
        else:
            halvings = 0
            rotations = lines.likely_rotations(limits, config.likely_rotations_of(self.rig.share))
        if not len(starts) or not len(rotations):
            none = self.index.starts[:0]
            return Candidates(starts[:0], none.new_zeros((0, 3, 3)), none, none[:, 0], none[:, 0]), 0
        every, most = self.index.views, max(1, config.rescored_pixels // max(1, len(self.rig.pixels)))
        views = every if len(starts) == self.index.num_starts else every.take(starts)
        patches = self.rig.patches(every.basis, halvings)
        if lines is None:
            scores = patch_scores(patches, every.descriptors(halvings).take(starts), rotations)
            best = scores.flatten().topk(min(max(count, most), scores.numel())).indices
            start, rotation = best // len(rotations), best % len(rotations)
            by_patches = config.histogram_weight * scores.flatten()[best]
        else:
            scores = scores_of_every_pose(self.rig.pixels, views, rotations)
            best = scores.flatten().topk(min(config.pool, scores.numel())).indices
            start, rotation = best // len(rotations), best % len(rotations)
            by_patches = 2 * config.histogram_weight * patch_scores_of(patches, views, rotations, start, rotation)
            again = (scores.flatten()[best] + by_patches).topk(min(most, len(best))).indices
            start, rotation, by_patches = start[again], rotation[again], by_patches[again]
        by_pixels, numbers = pixel_scores(self.rig.pixels, views, rotations, start, rotation), starts[start]
        found = Candidates(numbers, rotations[rotation], self.index.starts[numbers], by_pixels + by_patches, by_patches)
        if lines is None:
            return found.ranked(count, config.pool), scores.numel()
        return swept(self.rig, self.index, found.ranked(config.pool), count, config), scores.numel()

    def _rotations(self, halvings: int, limits: PoseLimits) -> Tensor:
        count = self.config.rotations_with(halvings)
        every = rotations_of(count, str(self.index.starts.device))
        allowed = limits.allows_rotation(every, rotation_spacing(count) / 2)
        return every if bool(allowed.all()) else every[allowed]


def search_maps(
    searches: Sequence[MapSearch],
    limits: Sequence[PoseLimits],
    lines: Sequence[LineEvidence | None],
    config: SearchConfig,
) -> tuple[list[Candidates], int, int]:
    """Propose poses in every map; searches, limits and lines go together. Wide rigs look only at the starts that a first pass likes best
    over all maps. Return candidates of each map, how many starts the limits leave in all maps, and how many poses were scored there."""
    starts = [search.starts(limit) for search, limit in zip(searches, limits, strict=True)]
    total = sum(map(len, starts))
    kept = math.ceil(config.kept_share * total)
    if searches[0].is_wide and kept < total:
        scores = _in_each(lambda search, limit: search.first_scores(limit), searches, limits)
        least = torch.cat(scores).topk(kept).values[-1]
        starts = [some[score >= least] for some, score in zip(starts, scores, strict=True)]
    found = _in_each(
        lambda search, limit, some, by: search.propose(limit, some, by, config.num_candidates),
        searches,
        limits,
        starts,
        lines,
    )
    return [candidates for candidates, _ in found], total, sum(num_poses for _, num_poses in found)


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
    assert len(patches.grid) == views.steps.shape[1], "patches of images and views of two sizes"
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
