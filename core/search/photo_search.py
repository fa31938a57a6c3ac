"""The search for photos: all starts with all rotations by histograms of patches, then the best poses again by what is inside of patches.

A photo shows few patches, and how its colours are distributed says little about how those of the whole view are. So histograms only
propose; of the poses that they like best, the small picture of the view is held against the photo pixel by pixel, both equalized over
what the photo shows. What patches say counts a little there, too: it ranks some right poses first that pixels rank late.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from core.config import DescriptorConfig, FineViewConfig, PhotoSearchConfig
from core.describe.fine_views import FineViews
from core.describe.patch_descriptors import ViewDescriptors, centered_roots, similarity_tensor
from core.describe.patch_histograms import soft_histograms
from core.describe.spherical_patches import PatchGrid
from core.geometry.distinct_poses import first_distinct
from core.geometry.projection import project
from core.geometry.rotations import uniform_rotations
from core.index.map_index import MapIndex
from core.light.color_equalization import LabelCodes, equalize
from core.panorama.photo_atlas import PhotoAtlas
from core.panorama.photo_colors import contrast_of_windows, equalized_windows
from core.search.map_search import MapCandidates
from core.search.pose_limits import PoseLimits
from core.search.pose_scores import Candidates

_LEAST_PATCH_SHARE = 0.25  # of the patch that shows most; patches that show less say little and cost as much
_RESCORED_AT_ONCE = 2_000_000  # pixels
_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class DescribedPhotos:
    """What photos look like, in the axes of the rig.

    roots: (Q, B) centred root histograms of the patches numbered `patches` (Q,), weighted `weights` (Q,), summing to one.
    directions: (S, 3), colors: (S, 3) and solid: (S,) of the pixels at the resolution of the map's small pictures; squares: (S,) int64,
    the square of pixels that each is in.
    """

    roots: Tensor
    patches: Tensor
    weights: Tensor
    directions: Tensor
    colors: Tensor
    solid: Tensor
    squares: Tensor


def describe_photos(
    atlas: PhotoAtlas,
    labels: LabelCodes | None,
    config: PhotoSearchConfig,
    fine: FineViewConfig,
    described: DescriptorConfig,
) -> DescribedPhotos:
    """Describe photos, the same for all maps that share their colours."""
    grid = PatchGrid(fine.patch_rows, fine.patch_columns)
    windows = atlas.windows(described.view_height)
    seen = windows.weights > 0
    directions, weights = atlas.rig_directions(windows)[seen], windows.weights[seen]
    patch = grid.patch_of_direction(directions)
    canonical = windows.color if labels is not None else equalized_windows(windows)
    parts = [soft_histograms(canonical[:, seen].T[None], weights[None], patch[None], len(grid), described.bins)]
    if labels is None:
        contrast = equalize(contrast_of_windows(atlas, windows)[:, seen].T[None], weights[None])
        parts.append(soft_histograms(contrast, weights[None], patch[None], len(grid), described.bins))
    roots, _ = centered_roots(torch.cat(parts, dim=-1), grid.solid_angles(weights.device))
    # A patch at the edge of a photo counts as much as the photo shows of it.
    shown = torch.zeros(len(grid), device=weights.device).index_add_(0, patch, weights)
    patches = _some_of((shown > _LEAST_PATCH_SHARE * shown.max()).nonzero()[:, 0], config.most_patches)
    small = atlas.windows(fine.picture_height)
    valid = small.weights > 0
    row, column = valid.nonzero(as_tuple=True)
    square = (small.photo[valid] * small.color.shape[1] + row // config.patch_pixels) * small.color.shape[2]
    _, squares = torch.unique(square + column // config.patch_pixels, return_inverse=True)
    return DescribedPhotos(
        roots[0, patches],
        patches,
        shown[patches] / shown[patches].sum(),
        atlas.rig_directions(small)[valid],
        small.color[:, valid].T.contiguous(),
        small.weights[valid],
        squares,
    )


def _some_of(patches: Tensor, most: int) -> Tensor:
    """Return at most so many of the patches (Q,), spread evenly over them: what several photos show is told by some of it."""
    if len(patches) <= most:
        return patches
    order = (torch.arange(len(patches), device=patches.device, dtype=torch.float64) * _GOLDEN).frac().argsort()
    return patches[order[:most].sort().values]


def search_photos(
    photos: Sequence[DescribedPhotos],
    maps: Sequence[MapIndex],
    limits: Sequence[PoseLimits],
    config: PhotoSearchConfig,
    fine: FineViewConfig,
) -> list[MapCandidates]:
    """Score the allowed poses of every map and choose candidates in each; photos, maps and limits go together."""
    return [
        _search_map(described, index, limit, config, fine)
        for described, index, limit in zip(photos, maps, limits, strict=True)
    ]


def _search_map(
    photos: DescribedPhotos, index: MapIndex, limits: PoseLimits, config: PhotoSearchConfig, fine: FineViewConfig
) -> MapCandidates:
    rotations, is_dense = _searched_rotations(limits, config, index.starts.device)
    poses, pixels = config.rescored_poses, config.rescored_pixels
    if is_dense:
        poses, pixels = config.limited_rescored_poses, config.limited_rescored_pixels
    rescored = min(poses, pixels // max(1, len(photos.directions)))
    return search_rotations(photos, index, limits, rotations, rescored, config, fine)


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
    again = _pixel_scores(photos, views, rotations, start, rotation, index.labels is not None, config)
    again = again + config.histogram_weight * scores.flatten()[best]
    order = again.argsort(descending=True)[: config.pool]
    turned, places = rotations[rotation[order]], index.starts[starts[start[order]]]
    distinct = first_distinct(turned, places, config.distinct, count=config.num_candidates)
    chosen = order[torch.tensor(distinct, dtype=torch.long, device=order.device)]
    found = Candidates(starts[start[chosen]], rotation[chosen], again[chosen])
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


def _pixel_scores(
    photos: DescribedPhotos,
    views: FineViews,
    rotations: Tensor,
    start: Tensor,
    rotation: Tensor,
    is_labels: bool,
    config: PhotoSearchConfig,
) -> Tensor:
    """Return the score (K,) of poses: mean correlation inside squares of pixels, and less where the scan shows less."""
    pictures, seen = views.pictures.flatten(1, 2).flatten(0, 1), views.seen.flatten()
    height, size = views.pictures.shape[1], views.pictures.shape[1] * views.pictures.shape[2]
    member = torch.nn.functional.one_hot(photos.squares).float()  # (S, G)
    # Once for all poses: that some see less of the scan where a photo looks hardly moves its colours.
    own = photos.colors if is_labels else equalize(photos.colors[None], photos.solid[None])[0]
    scores = []
    step = max(1, _RESCORED_AT_ONCE // len(photos.directions))
    for s, r in zip(torch.split(start, step), torch.split(rotation, step), strict=True):
        towards = torch.einsum("kab,sb->ksa", rotations[r], photos.directions)
        u, v = project(towards, height, 2 * height)
        pixel = v.long().clamp(0, height - 1) * (2 * height) + u.long().clamp(0, 2 * height - 1)
        at = (s[:, None] * size + pixel).flatten()
        scan = pictures.index_select(0, at).view(*pixel.shape, 3).float() / 255
        weights = seen.index_select(0, at).view(pixel.shape) * photos.solid
        if not is_labels:
            scan = equalize(scan, weights)
        inside, mass = _correlation_in_squares(scan, own.expand_as(scan), weights, member, config.min_variance)
        share = weights.sum(1) / photos.solid.sum()
        # By how much the other side explains a square; what has changed says nothing, and least of all against a pose.
        inside = 1 - (1 - inside.clamp(0, 1).square()).sqrt()
        scores.append((inside * mass).sum(1) / mass.sum(1).clamp_min(1e-9) * share.sqrt())
    return torch.cat(scores)


def _correlation_in_squares(
    first: Tensor, second: Tensor, weights: Tensor, member: Tensor, floor: float
) -> tuple[Tensor, Tensor]:
    """Return the correlation (K, G) of colours (K, S, 3) inside each square, all channels together, and what the squares weigh."""
    mass = weights @ member
    per = 1 / mass.clamp_min(1e-9)
    products = torch.cat((first, second, (first * second).sum(-1, keepdim=True)), dim=-1)
    squares = torch.stack((first.square().sum(-1), second.square().sum(-1)), dim=-1)
    stacked = torch.cat((products, squares), dim=-1) * weights[..., None]
    mean = torch.einsum("ksc,sg->kgc", stacked, member) * per[..., None]
    mean_first, mean_second = mean[..., :3], mean[..., 3:6]
    covariance = mean[..., 6] - (mean_first * mean_second).sum(-1)
    variances = mean[..., 7] - mean_first.square().sum(-1), mean[..., 8] - mean_second.square().sum(-1)
    return covariance / ((variances[0].clamp_min(0) + floor) * (variances[1].clamp_min(0) + floor)).sqrt(), mass
