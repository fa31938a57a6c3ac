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

from core.config import FineViewConfig, PhotoSearchConfig
from core.describe.patch_descriptors import ViewDescriptors, similarity_tensor
from core.describe.spherical_patches import PatchGrid
from core.geometry.distinct_poses import first_distinct
from core.geometry.rotations import uniform_rotations
from core.index.map_index import MapIndex
from core.search.described_photos import DescribedPhotos
from core.search.line_evidence import LineEvidence
from core.search.map_search import MapCandidates
from core.search.pixel_scores import pixel_scores
from core.search.pose_limits import PoseLimits
from core.search.pose_scores import Candidates
from core.search.position_sweep import swept


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
    rescored = min(config.likely_rescored_poses, config.likely_rescored_pixels // max(1, len(photos.pixels)))
    some = replace(config, num_candidates=config.swept, distinct=config.swept_distinct)
    found = search_rotations(photos, index, limits, rotations, rescored, some, fine)
    return swept(photos, index, found, config)


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
        empty = Candidates(starts[:0], starts[:0], starts[:0].float())
        return MapCandidates(empty, rotations, 0, 0)
    views = index.fine_views if len(starts) == index.num_starts else index.fine_views.take(starts)
    scores = _histogram_scores(photos, views.descriptors(), rotations, PatchGrid(fine.patch_rows, fine.patch_columns))
    best = scores.flatten().topk(min(rescored, scores.numel())).indices
    start, rotation = best // len(rotations), best % len(rotations)
    by_patches = config.histogram_weight * scores.flatten()[best]
    again = (
        pixel_scores(photos.pixels, views, rotations, start, rotation, index.labels is not None, config) + by_patches
    )
    order = again.argsort(descending=True)[: config.pool]
    turned, places = rotations[rotation[order]], index.starts[starts[start[order]]]
    distinct = first_distinct(turned, places, config.distinct, count=config.num_candidates)
    chosen = order[torch.tensor(distinct, dtype=torch.long, device=order.device)]
    found = Candidates(starts[start[chosen]], rotation[chosen], again[chosen], by_patches[chosen])
    return MapCandidates(found, rotations, len(starts), scores.numel())


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


def _histogram_scores(photos: DescribedPhotos, views: ViewDescriptors, rotations: Tensor, grid: PatchGrid) -> Tensor:
    """Return scores (T, R) of all poses by the descriptors of patches."""
    num_views, num_patches, _ = views.values.shape
    tensor = similarity_tensor(photos.roots @ views.basis, views.values).permute(1, 2, 0)  # (Q, P, T)
    spread = (tensor.square() * photos.weights[:, None, None]).sum(0) * views.weights.T
    deviation = spread.sum(0).sqrt().clamp_min(1e-9)
    rows = (tensor / deviation).reshape(-1, num_views)
    towards = torch.einsum("rab,qb->rqa", rotations, grid.centers(rotations.device)[photos.patches])
    meets = grid.nearest_patch(towards) + torch.arange(len(photos.patches), device=rotations.device) * num_patches
    weights = photos.weights.expand(len(rotations), -1).contiguous()
    return torch.nn.functional.embedding_bag(meets, rows, mode="sum", per_sample_weights=weights).T
