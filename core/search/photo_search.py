"""The search for photos: all starts with all rotations by histograms of patches, then the best poses again by what is inside of patches.

A photo shows few patches, and how its colours are distributed says little about how those of the whole view are. So histograms only
propose; of the poses that they like best, the small picture of the view is held against the photo pixel by pixel, both equalized over
what the photo shows. What patches say counts a little there, too: it ranks some right poses first that pixels rank late.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from panoloc.core.config import FineViewConfig, PhotoSearchConfig
from panoloc.core.features.fine_views import FineViews
from panoloc.core.features.patch_grid import PatchGrid
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import uniform_rotations
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.every_pose import scores_of_every_pose
from panoloc.core.search.line_evidence import LineEvidence
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.patch_scores import patch_scores, patch_scores_of
from panoloc.core.search.pixel_scores import pixel_scores
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.pose_scores import Candidates
from panoloc.core.search.position_sweep import swept


def search_photos(
    photos: Sequence[DescribedPhotos],
    maps: Sequence[MapIndex],
    limits: Sequence[PoseLimits],
    lines: Sequence[LineEvidence | None],
    config: PhotoSearchConfig,
    fine: FineViewConfig,
) -> list[MapCandidates]:
    """Score the allowed poses of every map and choose candidates in each; photos, maps, limits and lines go together.

    lines: what the edges of the photos say of rotations, where only those are searched that they agree with.
    """
    return [
        _search_map(described, index, limit, config, fine)
        if support is None
        else _search_by_lines(described, index, limit, support, config, fine)
        for described, index, limit, support in zip(photos, maps, limits, lines, strict=True)
    ]


def _search_map(
    photos: DescribedPhotos, index: MapIndex, limits: PoseLimits, config: PhotoSearchConfig, fine: FineViewConfig
) -> MapCandidates:
    rotations, is_dense = _searched_rotations(limits, config, index.starts.device)
    poses, pixels = config.rescored_poses, config.rescored_pixels
    if is_dense:
        poses, pixels = config.limited_rescored_poses, config.limited_rescored_pixels
    rescored = min(poses, pixels // max(1, len(photos.pixels)))
    return search_rotations(photos, index, limits, rotations, rescored, config, fine)


def _search_by_lines(
    photos: DescribedPhotos,
    index: MapIndex,
    limits: PoseLimits,
    lines: LineEvidence,
    config: PhotoSearchConfig,
    fine: FineViewConfig,
) -> MapCandidates:
    """Search the few rotations that lines leave, and the places around the starts as well."""
    rotations = lines.likely_rotations(limits, config)
    some = replace(config, num_candidates=config.swept, distinct=config.swept_distinct)
    return swept(photos, index, search_likely(photos, index, limits, rotations, some, fine), config)


def search_likely(
    photos: DescribedPhotos,
    index: MapIndex,
    limits: PoseLimits,
    rotations: Tensor,
    config: PhotoSearchConfig,
    fine: FineViewConfig,
) -> MapCandidates:
    """Score the starts that the limits allow with a few rotations (R, 3, 3), every pose by pixels, and choose candidates.

    The best are scored by patches as well, and the best of these again with the colours that each pose sees.
    """
    starts = limits.searched_starts(index.starts, config.limit_margin_m).nonzero()[:, 0]
    if len(starts) == 0 or len(rotations) == 0:
        return _nothing(starts, rotations)
    views, is_labels = _views_of(index, starts), index.labels is not None
    scores = scores_of_every_pose(photos.pixels, views, rotations, is_labels, config)
    best = scores.flatten().topk(min(config.likely_described_poses, scores.numel())).indices
    start, rotation = best // len(rotations), best % len(rotations)
    grid = PatchGrid(fine.patch_rows, fine.patch_columns)
    by_patches = patch_scores_of(photos, views, rotations, start, rotation, grid)
    by_patches = config.likely_histogram_weight * by_patches
    count = min(config.likely_rescored_poses, config.likely_rescored_pixels // max(1, len(photos.pixels)))
    again = (scores.flatten()[best] + by_patches).topk(min(count, len(best))).indices
    start, rotation, by_patches = start[again], rotation[again], by_patches[again]
    rescored = pixel_scores(photos.pixels, views, rotations, start, rotation, is_labels, config) + by_patches
    found = _first_candidates(index, rotations, starts[start], rotation, rescored, by_patches, config)
    return MapCandidates(found, rotations, len(starts), scores.numel())


def search_rotations(
    photos: DescribedPhotos,
    index: MapIndex,
    limits: PoseLimits,
    rotations: Tensor,
    rescored: int,
    config: PhotoSearchConfig,
    fine: FineViewConfig,
) -> MapCandidates:
    """Score the starts that the limits allow with rotations (R, 3, 3), the best `rescored` again by pixels, and choose candidates."""
    starts = limits.searched_starts(index.starts, config.limit_margin_m).nonzero()[:, 0]
    if len(starts) == 0 or len(rotations) == 0:
        return _nothing(starts, rotations)
    views = _views_of(index, starts)
    scores = patch_scores(photos, views.descriptors(), rotations, PatchGrid(fine.patch_rows, fine.patch_columns))
    best = scores.flatten().topk(min(rescored, scores.numel())).indices
    start, rotation = best // len(rotations), best % len(rotations)
    by_patches = config.histogram_weight * scores.flatten()[best]
    again = (
        pixel_scores(photos.pixels, views, rotations, start, rotation, index.labels is not None, config) + by_patches
    )
    found = _first_candidates(index, rotations, starts[start], rotation, again, by_patches, config)
    return MapCandidates(found, rotations, len(starts), scores.numel())


def _nothing(starts: Tensor, rotations: Tensor) -> MapCandidates:
    """Return no candidates; starts: none."""
    return MapCandidates(Candidates(starts[:0], starts[:0], starts[:0].float()), rotations, 0, 0)


def _views_of(index: MapIndex, starts: Tensor) -> FineViews:
    """Return the views of the starts (S,)."""
    return index.fine_views if len(starts) == index.num_starts else index.fine_views.take(starts)


def _first_candidates(
    index: MapIndex,
    rotations: Tensor,
    starts: Tensor,
    rotation: Tensor,
    scores: Tensor,
    by_patches: Tensor,
    config: PhotoSearchConfig,
) -> Candidates:
    """Return the best of poses by `scores` (K,) that differ; their starts (K,), the numbers (K,) of their rotations, and what of the score
    patches say (K,)."""
    order = scores.argsort(descending=True)[: config.pool]
    turned, places = rotations[rotation[order]], index.starts[starts[order]]
    distinct = first_distinct(turned, places, config.distinct, count=config.num_candidates)
    chosen = order[torch.tensor(distinct, dtype=torch.long, device=order.device)]
    return Candidates(starts[chosen], rotation[chosen], scores[chosen], by_patches[chosen])


def _searched_rotations(limits: PoseLimits, config: PhotoSearchConfig, device: torch.device) -> tuple[Tensor, bool]:
    """Return the rotations (R, 3, 3) that the limits leave, and whether they are of a denser set: where they leave few of it."""
    margin = math.radians(config.limit_margin_deg)
    dense = dense_rotations(config, device)
    kept = limits.allows_rotation(dense, margin)
    if int(kept.sum()) <= config.most_rotations:
        return dense[kept], True
    usual = _rotations(config.num_rotations, str(device))
    return usual[limits.allows_rotation(usual, margin)], False


def dense_rotations(config: PhotoSearchConfig, device: torch.device) -> Tensor:
    """Return the rotations (R, 3, 3) that are searched where few are left of them."""
    return _rotations(config.limited_rotations, str(device))


def line_rotations(config: PhotoSearchConfig, device: torch.device) -> Tensor:
    """Return the rotations (R, 3, 3) of which lines leave some."""
    return _rotations(config.line_rotations, str(device))


@lru_cache(maxsize=4)
def _rotations(count: int, device: str) -> Tensor:
    with torch.inference_mode(False):  # they outlive the query that asked for them first
        return uniform_rotations(count).to(device)
