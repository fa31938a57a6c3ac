"""Which of many maps a rig may be in: its patches or pixels against the retrieval vectors of every start of every map.

Where the images show enough edges, these tell how the rig is turned against walls, up to the 24 ways in which three axes at right angles
fit each other. So a start is compared with the rig in a few rotations alone.

Patches tell what covers much of the sphere. What shows less has few of them, and is told by large pixels. Under each rotation their mean
difference is the light's. What is left of a difference counts up to a limit: furniture that was moved speaks no louder against a place than
that, nor does what the scan lacks.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from panoloc.core.config import SearchConfig
from panoloc.core.features.patch_descriptors import DescribedPatches
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.geometry.rotations import rotations_of, turns_of_axes
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.map.retrieval_vectors import HALVINGS, ROWS, UNSEEN, RetrievalVectors, levels_of, retrieval_basis
from panoloc.core.search.described_rig import DescribedRig

_TURNS = 16  # of a quarter; maps whose walls stand alike share their rotations
_MOST_OFF = 20  # levels that a difference counts for, of 254 from black to white
_ROTATIONS_AT_ONCE = 64


def scores_of_maps(
    rig: DescribedRig,
    walls: Tensor | None,
    maps: Sequence[RetrievalVectors],
    max_tilt: float | None,
    is_wide: bool,
    config: SearchConfig,
) -> Tensor:
    """Return the score (M,) of each map at its best start.

    walls: axes_from_rig (3, 3), along walls as far as edges of the images tell; None where these say little. max_tilt: of the rig, radians;
    None for any. is_wide: whether the rig is told by patches.
    """
    rotations = _rotations(walls, str(maps[0].steps.device), max_tilt, config)
    sizes = torch.tensor([len(one) for one in maps])
    scores = (_by_patches if is_wide else _by_pixels)(rig, rotations, maps, sizes)
    owner = torch.arange(len(maps), device=scores.device).repeat_interleave(sizes.to(scores.device))
    return scores.new_full((len(maps),), -math.inf).scatter_reduce(0, owner, scores, "amax")


def _by_patches(rig: DescribedRig, rotations: Tensor, maps: Sequence[RetrievalVectors], sizes: Tensor) -> Tensor:
    """Return how much (N,) patches agree with each start of all maps, which have so many (M,), under the best rotation."""
    basis = retrieval_basis()[0].to(rotations.device)
    patches = rig.patches(basis, HALVINGS)
    quarter = math.pi / 2
    axes = torch.stack([one.axes[0] for one in maps])
    turns = (axes[:, 1].atan2(axes[:, 0]) / quarter * _TURNS).round().long() % _TURNS
    known, numbers = torch.unique(turns, return_inverse=True)
    queries = torch.stack(
        [_vectors_of(patches, _about_z(turn * quarter / _TURNS).to(rotations) @ rotations) for turn in known.tolist()]
    )
    # So finely that sums of products of them and of steps fit into 32 bits.
    most = torch.iinfo(torch.int32).max // (torch.iinfo(torch.int8).max * queries.shape[-1])
    step = queries.abs().max().clamp_min(1e-9) / most
    queries = (queries / step).round()
    if has_kernels_for(queries):
        best, addresses = queries.new_empty(int(sizes.sum())), torch.tensor([one.steps.data_ptr() for one in maps])
        given = addresses, sizes, sizes.cumsum(0) - sizes, numbers, len(maps)
        call("retrieval_by_patches", *given, queries.to(torch.int16), *queries.shape[1:], best)
    else:
        pairs = zip(maps, numbers.tolist(), strict=True)
        best = torch.cat([(one.steps.to(queries.dtype) @ queries[number].T).amax(1) for one, number in pairs])
    return best * torch.cat([one.scale for one in maps]) * step


def _by_pixels(rig: DescribedRig, rotations: Tensor, maps: Sequence[RetrievalVectors], sizes: Tensor) -> Tensor:
    """Return the share (N,) of pixels' levels that agree with each start of all maps, which have so many (M,), under the best rotation."""
    directions, colors, solid = rig.large_pixels
    chosen = _evenly_spread(solid)
    own, towards = levels_of(colors[chosen]), directions[chosen] @ rotations.mT  # (R, S, 3), in the axes of walls
    if has_kernels_for(towards):
        addresses = torch.tensor([one.levels.data_ptr() for one in maps])
        off = towards.new_empty(int(sizes.sum()))
        given = addresses, sizes, sizes.cumsum(0) - sizes, torch.stack([one.axes for one in maps]), len(maps), ROWS
        call("retrieval_by_pixels", *given, own, towards, *towards.shape[:2], _MOST_OFF, off)
    else:
        off = torch.cat([_levels_off(own, towards, one) for one in maps])
    return 1 - off / (own.numel() * _MOST_OFF)


def _evenly_spread(solid: Tensor) -> Tensor:
    """Return the numbers (S,) of pixels that lie evenly spread over what all of them, with solid angles (N,), show: so few that the sum of
    their differences fits into 16 bits."""
    count = min(len(solid), torch.iinfo(torch.int16).max // torch.iinfo(torch.uint8).max)
    ends = solid.cumsum(0) / solid.sum()
    places = (torch.arange(count, device=solid.device) + 0.5) / count
    return torch.searchsorted(ends, places).clamp_max(len(solid) - 1)


def _levels_off(own: Tensor, towards: Tensor, one: RetrievalVectors) -> Tensor:
    """Return by how many levels (T,) the starts of a map are off under the best rotation: from levels (S, 3) of pixels that look towards
    (R, S, 3) in the axes of walls."""
    at = pixels_towards(towards @ one.axes.to(towards), ROWS)
    seen = (one.levels[:, :1] != UNSEEN).float()
    shown, least = one.levels * seen, []
    for some in torch.split(at, _ROTATIONS_AT_ONCE):
        known = seen[some]
        off = shown[some] - own[..., None] * known  # (R, S, 3, T)
        light = (off.sum(1, keepdim=True) / known.sum(1, keepdim=True).clamp_min(1)).round()
        agreed = (_MOST_OFF - off.sub_(light).abs_()).clamp_min_(0).mul_(known)
        least.append(own.numel() * _MOST_OFF - agreed.sum((1, 2)))
    return torch.cat(least).amin(0)


def _rotations(walls: Tensor | None, device: str, max_tilt: float | None, config: SearchConfig) -> Tensor:
    """Return the rotations (R, 3, 3) axes_from_rig that are tried, tilted no more than allowed where any are not."""
    tried = rotations_of(config.rotations_with(2), device) if walls is None else turns_of_axes(device) @ walls
    if max_tilt is None:
        return tried
    allowed = tried[tried[:, 2, 2] >= math.cos(max_tilt)]
    return allowed if len(allowed) else tried


def _about_z(angle: float) -> Tensor:
    """Return the rotation (3, 3) about z by `angle` radians."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _vectors_of(patches: DescribedPatches, rotations: Tensor) -> Tensor:
    """Return what a start would show if the rig stood there under each of the rotations, (R, P D)."""
    weighted = patches.values * patches.weights[:, None]
    shown = weighted.new_zeros((len(rotations), len(patches.grid), weighted.shape[1]))
    towards = patches.towards(rotations)[..., None].expand(-1, -1, weighted.shape[1])
    return shown.scatter_add_(1, towards, weighted.expand(len(rotations), -1, -1)).flatten(1)
