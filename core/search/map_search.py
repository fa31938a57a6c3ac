"""The search of the `fast` method: every start with every rotation, for all maps of a query.

One similarity tensor per map and query, of which pose scores are a weighted gather (docs/method.md). Where there are many starts, a first
pass on a quarter of the patches and of the rotations discards most of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.config import DescriptorConfig, SearchConfig
from panoloc.core.features.equalization import LabelCodes
from panoloc.core.features.patch_descriptors import (
    ViewDescriptors,
    centered_roots,
    normalize_per_view,
    pooled,
    similarity_tensor,
)
from panoloc.core.features.patch_grid import PatchGrid, rotation_table
from panoloc.core.features.patch_histograms import described_histograms
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.image.pyramid import PanoramaPyramid
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.pose_scores import Candidates, score_poses, select_candidates


@dataclass(frozen=True)
class RotationSet:
    """The rotations searched (R, 3, 3), map_from_camera, and which patches meet under each (R, P)."""

    rotations: Tensor
    table: Tensor

    def take(self, keep: Tensor) -> "RotationSet":
        """Return the rotations where `keep` (R,) is true."""
        return self if bool(keep.all()) else RotationSet(self.rotations[keep], self.table[keep])


@dataclass(frozen=True)
class SearchRotations:
    """The rotations of the search, and the fewer ones of its first pass on half the rows and columns of patches."""

    full: RotationSet
    coarse: RotationSet


def make_search_rotations(config: SearchConfig, grid: PatchGrid, device: torch.device) -> SearchRotations:
    """Make the rotations of a configuration once; they do not depend on map or query."""
    coarse_grid = PatchGrid(grid.rows // 2, grid.columns // 2)
    full, coarse = (uniform_rotations(count).to(device) for count in (config.num_rotations, config.coarse_rotations))
    return SearchRotations(
        RotationSet(full, rotation_table(grid, full)), RotationSet(coarse, rotation_table(coarse_grid, coarse))
    )


@dataclass(frozen=True)
class DescribedPanorama:
    """Centred root histograms (P, M) of a panorama's patches and the patches' weights (P,); M as in `described_histograms`."""

    roots: Tensor
    weights: Tensor


def describe_panorama(
    pyramid: PanoramaPyramid, labels: LabelCodes | None, config: DescriptorConfig
) -> DescribedPanorama:
    """Describe the patches of a panorama, the same for all maps that share its colours."""
    level = pyramid.level(config.view_height)
    grid = PatchGrid(config.patch_rows, config.patch_columns)
    color, valid = level.color.permute(1, 2, 0)[None], level.valid[None]
    canonical = level.canonical(labels).flatten(1).T[None]
    histogram = described_histograms(
        color, canonical, valid, level.weights()[None], grid, config.bins, labels is not None
    )
    roots, weights = centered_roots(histogram, grid.solid_angles(color.device))
    return DescribedPanorama(roots[0], weights[0])


@dataclass(frozen=True)
class MapCandidates:
    """What the search found in one map: starts numbered in its index, rotations in `rotations` (R, 3, 3).

    num_starts: that the hints left. num_poses: that were scored, in both passes.
    """

    candidates: Candidates
    rotations: Tensor
    num_starts: int
    num_poses: int


def search_maps(
    panoramas: Sequence[DescribedPanorama],
    maps: Sequence[MapIndex],
    rotations: SearchRotations,
    limits: Sequence[PoseLimits],
    config: SearchConfig,
) -> list[MapCandidates]:
    """Score the allowed poses of every map and choose candidates in each; panoramas, maps and limits go together."""
    searches = [
        _MapSearch(panorama, index, rotations, limit, config)
        for panorama, index, limit in zip(panoramas, maps, limits, strict=True)
    ]
    total = sum(len(search.starts) for search in searches)
    kept = max(config.coarse_kept_starts, round(config.coarse_kept_share * total))
    if kept < total:
        _discard_starts(searches, kept)
    return [search.run() for search in searches]


def _discard_starts(searches: Sequence["_MapSearch"], count: int) -> None:
    """Keep the `count` starts that the first pass likes best over all maps."""
    scores = [search.coarse_scores() for search in searches]
    least = torch.cat(scores).topk(count).values[-1]
    for search, score in zip(searches, scores, strict=True):
        search.starts = search.starts[score >= least]


class _MapSearch:
    """One map on its way through the search; `starts` (T,) are the numbers of those not discarded."""

    def __init__(
        self,
        panorama: DescribedPanorama,
        index: MapIndex,
        rotations: SearchRotations,
        limits: PoseLimits,
        config: SearchConfig,
    ) -> None:
        self.index, self.weights, self.config = index, panorama.weights, config
        self.query = panorama.roots @ index.descriptors.basis
        self.full = rotations.full.take(limits.searched_rotations(rotations.full.rotations, config.hint_margin_deg))
        self.coarse = rotations.coarse.take(
            limits.searched_rotations(rotations.coarse.rotations, config.hint_margin_deg)
        )
        self.starts = limits.searched_starts(index.starts, config.hint_margin_m).nonzero()[:, 0]
        if len(self.full.rotations) == 0:
            self.starts = self.starts[:0]
        self.num_allowed, self.num_coarse_poses = len(self.starts), 0

    def coarse_scores(self) -> Tensor:
        """Return the score (T,) of each start under its best rotation of the first pass, infinite where the hints leave none."""
        if len(self.starts) == 0 or len(self.coarse.rotations) == 0:
            return torch.full((len(self.starts),), torch.inf, device=self.starts.device)
        query, weights = pooled(self.query[None], self.weights[None])
        self.num_coarse_poses = len(self.starts) * len(self.coarse.rotations)
        return scores_of_starts(query[0], weights[0], self.index.coarse_views, self.starts, self.coarse.table).amax(1)

    def run(self) -> MapCandidates:
        """Score the starts that are left with all rotations, and choose candidates."""
        starts, rotations = self.starts, self.full.rotations
        num_poses = self.num_coarse_poses + len(starts) * len(rotations)
        if len(starts) == 0:
            empty = Candidates(starts, starts, starts.float())
            return MapCandidates(empty, rotations, self.num_allowed, num_poses)
        scores = scores_of_starts(self.query, self.weights, self.index.descriptors, starts, self.full.table)
        chosen = select_candidates(scores, self.index.starts[starts], rotations, self.config)
        found = Candidates(starts[chosen.starts], chosen.rotations, chosen.scores)
        return MapCandidates(found, rotations, self.num_allowed, num_poses)


def scores_of_starts(query: Tensor, weights: Tensor, views: ViewDescriptors, starts: Tensor, table: Tensor) -> Tensor:
    """Return scores (T, R) of the starts (T,) of a map under the rotations of a table (R, P), by query patches (P, D)."""
    every = len(starts) == len(views.values)
    values, view_weights = (views.values, views.weights) if every else (views.values[starts], views.weights[starts])
    tensor = normalize_per_view(similarity_tensor(query, values), weights, view_weights)
    return score_poses(tensor, table, weights)
