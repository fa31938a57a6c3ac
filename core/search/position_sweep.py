"""Candidates: the poses that a search proposes in one map, moved to where they fit best around their starts.

Starts lie half a metre apart, and from a quarter of a metre beside a place things at arm's length are ten degrees off: the right start may
rank behind many wrong ones. So the view of a start, whose depths are known, is also held against the images as it would look from places
around the start, before candidates are chosen.
"""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES, SearchConfig
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.kernels.library import has_kernels_for
from panoloc.core.map.map_index import MapIndex
from panoloc.core.render.synthetic_view import RENDER_BATCH, depths_from, render_views
from panoloc.core.search.described_rig import DescribedRig, RigPixels
from panoloc.core.search.pixel_scores import compiled_scores, scores_at

_PIXELS_AT_ONCE = 1_000_000
_FAR_M = 30.0


@dataclass(frozen=True)
class Candidates:
    """K poses, best first: starts (K,) that they were found at, rotations (K, 3, 3) map_from_rig, positions (K, 3) metres, scores (K,).

    by_patches: (K,), what histograms of patches add to the scores.
    """

    starts: Tensor
    rotations: Tensor
    positions: Tensor
    scores: Tensor
    by_patches: Tensor

    def __len__(self) -> int:
        return len(self.starts)

    def take(self, chosen: Tensor | slice) -> "Candidates":
        """Return those that numbers or a slice choose."""
        return Candidates(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def ranked(self, count: int, pool: int | None = None) -> "Candidates":
        """Return the best of the first `pool` poses by score, at most `count`, none at the place of one before it."""
        some = self.take(self.scores.argsort(descending=True)[:pool])
        chosen = first_distinct(some.rotations, some.positions, DISTANCES.place, count=count)
        return some.take(torch.tensor(chosen, dtype=torch.long, device=some.starts.device))


def swept(rig: DescribedRig, index: MapIndex, found: Candidates, count: int, config: SearchConfig) -> Candidates:
    """Return candidates at the best of the places around their starts, best first, at most `count` and none near one before it.

    The first of them are then looked at on finer pictures, at places around those, which ranks them anew among each other.
    """
    spacing = float(index.leaf_sizes.max())
    cube = cube_of_places(spacing, config.sweep_places, index.starts.device)
    coarse = found.take(slice(max(1, config.rescored_pixels // (len(cube) * len(rig.pixels)))))
    if len(coarse) == 0:
        return found
    every = _moved(rig.pixels, index, coarse, cube).ranked(count)
    finer = cube_of_places(spacing / config.sweep_places, config.sweep_places, index.starts.device)
    most = max(1, config.rescored_pixels // (len(finer) * len(rig.finer_pixels)))
    first, rest = every.take(slice(most)), every.take(slice(most, None))
    closer = _moved(rig.finer_pixels, index, first, finer)
    # Scores of finer pictures are lower: what is ranked anew shares out the scores that it had.
    ranked = replace(closer.take(closer.scores.argsort(descending=True)), scores=first.scores)
    return Candidates(*(torch.cat((getattr(ranked, f.name), getattr(rest, f.name))) for f in fields(Candidates)))


def _moved(pixels: RigPixels, index: MapIndex, some: Candidates, offsets: Tensor) -> Candidates:
    """Return candidates at the best of places around where they are, `offsets` (O, 3) metres from there, with the scores there."""
    around = (some.positions - index.starts[some.starts])[:, None] + offsets
    best, which = _scores_around(pixels, index, some.starts, some.rotations, around).max(1)
    at = around[torch.arange(len(around), device=which.device), which]
    return replace(some, positions=index.starts[some.starts] + at, scores=best + some.by_patches)


def cube_of_places(side_m: float, count: int, device: torch.device) -> Tensor:
    """Return the middles (count³, 3), metres, of cubes that fill one of `side_m` around the origin."""
    side = (torch.arange(count, device=device) + 0.5) * (side_m / count) - side_m / 2
    return torch.stack(torch.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)


def _scores_around(pixels: RigPixels, index: MapIndex, starts: Tensor, turns: Tensor, offsets: Tensor) -> Tensor:
    """Return the scores (K, O) of K poses with the rotations `turns` (K, 3, 3), at `offsets` (K, O, 3) metres from their starts (K,)."""
    numbers, row = torch.unique(starts, return_inverse=True)
    depth, pictures, seen = _views(index, numbers, pixels.rows)
    if has_kernels_for(turns):
        count = offsets.shape[1]
        poses = row.repeat_interleave(count), turns.repeat_interleave(count, 0)
        return compiled_scores(pixels, pictures, seen, *poses, depth, offsets).view(-1, count)
    scores, step = [], max(1, _PIXELS_AT_ONCE // (offsets.shape[1] * len(pixels)))
    for view, turn, moved in zip(*(torch.split(x, step) for x in (row, turns, offsets)), strict=True):
        towards = torch.einsum("kab,sb->ksa", turn, pixels.directions)[:, None]
        centers = moved[:, :, None] + torch.einsum("kab,sb->ksa", turn, pixels.centers)[:, None]
        at = _seen_from(centers, towards, depth[view], pixels.rows) + view[:, None, None] * depth.shape[1]
        scores.append(scores_at(pixels, pictures, seen, at.flatten(0, 1)).view(at.shape[:2]))
    return torch.cat(scores)


def _views(index: MapIndex, starts: Tensor, height: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return the depths (T, P) metres that starts see, and their pictures (T P, 3) uint8 and what of these was seen (T P,)."""
    stored = index.views.pictures.shape[1] == height
    depths, colors, valid = [], [], []
    for part in torch.split(starts, RENDER_BATCH):
        if stored:
            depths.append(depths_from(index.render_cloud, index.starts[part], height).flatten(1))
            continue
        views = render_views(index.render_cloud, index.starts[part], height, with_points=False)
        depths.append(views.depth.flatten(1))
        colors.append((views.color * 255).round().byte().flatten(0, 2))
        valid.append(views.valid.flatten())
    depth = torch.cat(depths).clamp(max=_FAR_M)
    if stored:
        return depth, index.views.pictures[starts].flatten(0, 2), index.views.seen[starts].flatten()
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
    along = (on_ray * length / distance - (centers * towards).sum(-1)).clamp_min(DISTANCES.same.distance_m)[..., None]
    return pixels_towards(centers + along * towards, height)
