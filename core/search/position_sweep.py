"""Candidates moved to where they fit best around their starts.

Starts lie half a metre apart, and from a quarter of a metre beside a place things at arm's length are ten degrees off: the right start may
rank behind many wrong ones. So the view of a start, whose depths are known, is also held against the photo as it would look from places
around the start, before candidates are chosen.
"""

from dataclasses import replace

import torch
from torch import Tensor

from panoloc.core.config import PhotoSearchConfig
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.map.map_index import MapIndex
from panoloc.core.render.synthetic_view import RENDER_BATCH, render_views
from panoloc.core.search.described_photos import DescribedPhotos, PhotoPixels
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.pixel_scores import ComparedColors
from panoloc.core.search.pose_scores import Candidates

_PIXELS_AT_ONCE = 1_000_000
_FAR_M, _NEAREST_M = 30.0, 0.1


def swept(photos: DescribedPhotos, index: MapIndex, found: MapCandidates, config: PhotoSearchConfig) -> MapCandidates:
    """Return candidates with the rotations and starts of those found, at the best of the places around their starts, best first.

    The first of them are then looked at on finer pictures, at places around those, which ranks them anew among each other.
    """
    spacing = float(index.leaf_sizes.max())
    a_side = max(1, min(round(spacing / config.sweep_step_m), config.most_swept_a_side))
    cube = cube_of_places(spacing, a_side, index.starts.device)
    most = max(config.fewest_swept, config.swept_pixels // (len(cube) * len(photos.pixels)))
    coarse = _first(found.candidates, most)
    if len(coarse) == 0:
        return found
    best, moved = _moved(photos.pixels, index, found, coarse, cube.expand(len(coarse), -1, 3), config)
    order = best.argsort(descending=True)
    places = index.starts[coarse.starts] + moved
    turned = found.rotations[coarse.rotations]
    kept = first_distinct(turned[order], places[order], config.swept_distinct, count=config.num_candidates)
    order = order[torch.tensor(kept, dtype=torch.long, device=order.device)]
    every = replace(coarse.take(order), scores=best[order])
    moved = moved[order]
    if photos.finer is not None and config.swept_closer > 0:
        finer = cube_of_places(spacing / a_side, config.closer_a_side, order.device)
        most = max(config.fewest_swept_closer, config.swept_pixels // (len(finer) * len(photos.finer)))
        first = _first(every, min(most, config.swept_closer))
        best, closer = _moved(photos.finer, index, found, first, moved[: len(first), None] + finer, config)
        rank = best.argsort(descending=True)
        # Scores of finer pictures are lower: what is ranked anew shares out the scores that it had.
        order = torch.cat((rank, torch.arange(len(rank), len(every), device=rank.device)))
        moved = torch.cat((closer, moved[len(first) :]))[order]
        every = Candidates(every.starts[order], every.rotations[order], every.scores)
    return replace(found, candidates=replace(every, by_patches=None, places=index.starts[every.starts] + moved))


def _first(candidates: Candidates, count: int) -> Candidates:
    """Return the first candidates, at most `count`."""
    return candidates.take(torch.arange(min(count, len(candidates)), device=candidates.starts.device))


def _moved(
    photos: PhotoPixels,
    index: MapIndex,
    found: MapCandidates,
    some: Candidates,
    offsets: Tensor,
    config: PhotoSearchConfig,
) -> tuple[Tensor, Tensor]:
    """Return the best score (K,) that candidates have at `offsets` (K, O, 3) metres from their starts, and the offset there (K, 3)."""
    scores = _scores_around(photos, index, some.starts, found.rotations[some.rotations], offsets, config)
    best, which = scores.max(1)
    at = offsets[torch.arange(len(offsets), device=which.device), which]
    return best if some.by_patches is None else best + some.by_patches, at


def cube_of_places(side_m: float, count: int, device: torch.device) -> Tensor:
    """Return the middles (count³, 3), metres, of cubes that fill one of `side_m` around the origin."""
    side = (torch.arange(count, device=device) + 0.5) * (side_m / count) - side_m / 2
    return torch.stack(torch.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)


def _scores_around(
    photos: PhotoPixels, index: MapIndex, starts: Tensor, turns: Tensor, offsets: Tensor, config: PhotoSearchConfig
) -> Tensor:
    """Return the scores (K, O) of K poses with the rotations `turns` (K, 3, 3), at `offsets` (K, O, 3) metres from their starts (K,)."""
    numbers, row = torch.unique(starts, return_inverse=True)
    depth, pictures, seen = _views(index, numbers, photos.rows)
    compared, scores = ComparedColors(photos, index.labels is not None, config), []
    step = max(1, _PIXELS_AT_ONCE // (offsets.shape[1] * len(photos)))
    for view, turn, moved in zip(*(torch.split(x, step) for x in (row, turns, offsets)), strict=True):
        towards = torch.einsum("kab,sb->ksa", turn, photos.directions)[:, None]
        centers = moved[:, :, None] + torch.einsum("kab,sb->ksa", turn, photos.centers)[:, None]
        at = _seen_from(centers, towards, depth[view], photos.rows) + view[:, None, None] * depth.shape[1]
        scores.append(compared.scores(pictures, seen, at.flatten(0, 1)).view(at.shape[:2]))
    return torch.cat(scores)


def _views(index: MapIndex, starts: Tensor, height: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the depths (T, P) metres that starts see, and their pictures (T P, 3) uint8 and what of these was seen (T P,)."""
    stored = index.fine_views.pictures.shape[1] == height
    depths, colors, valid = [], [], []
    for part in torch.split(starts, RENDER_BATCH):
        views = render_views(index.render_cloud, index.starts[part], height, with_points=False)
        depths.append(views.depth.flatten(1))
        if not stored:
            colors.append((views.color * 255).round().byte().flatten(0, 2))
            valid.append(views.valid.flatten())
    depth = torch.cat(depths).clamp(max=_FAR_M)
    if stored:
        return depth, index.fine_views.pictures[starts].flatten(0, 2), index.fine_views.seen[starts].flatten()
    return depth, torch.cat(colors), torch.cat(valid)


def _seen_from(centers: Tensor, towards: Tensor, depth: Tensor, height: int) -> Tensor:
    """Return the numbers (K, O, S) of the pixels of views that cameras see in directions `towards` (K, 1, S, 3).

    centers: (K, O, S or 1, 3) metres, of the cameras, from those of the views. depth: (K, P), of the views.

    What lies in a direction from a place beside the centre is looked for along the ray from there: where the view has what it has in that
    direction, and once more where it has what it has there.
    """
    along = depth.gather(1, pixels_towards(towards, height).flatten(1)).view(*towards.shape[:3], 1)
    where = centers + along * towards  # (K, O, S, 3)
    pixel = pixels_towards(where, height)
    length = depth.gather(1, pixel.flatten(1)).view(pixel.shape)
    # The place on the ray that is nearest to the point there; summed by hand, for norms of triples take several times as long.
    on_ray = (where * towards).sum(-1)
    distance = where.square().sum(-1).sqrt().clamp_min(1e-6)
    along = (on_ray * length / distance - (centers * towards).sum(-1)).clamp_min(_NEAREST_M)[..., None]
    return pixels_towards(centers + along * towards, height)
