"""Which of many maps a rig may be in: its patches against the retrieval vectors of every start of every map.

Where the images show enough edges, these tell how the rig is turned against walls, up to the 24 ways in which three axes at right angles
fit each other. So a start is compared with the rig in a few rotations alone.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from panoloc.core.config import SearchConfig
from panoloc.core.features.line_support import LineSupport
from panoloc.core.features.patch_descriptors import DescribedPatches
from panoloc.core.geometry.rotations import rotations_of, rotations_of_axes, turns_of_axes
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.map.retrieval_vectors import HALVINGS, RetrievalVectors, retrieval_basis
from panoloc.core.search.described_rig import DescribedRig

_TURNS = 16  # of a quarter; maps whose walls stand alike share their rotations


def scores_of_maps(
    rig: DescribedRig,
    lines: LineSupport | None,
    maps: Sequence[RetrievalVectors],
    max_tilt: float | None,
    config: SearchConfig,
) -> Tensor:
    """Return the score (M,) of each map at its best start.

    lines: of the edges of the images; None where these say little. max_tilt: of the rig, radians; None for any.
    """
    basis = retrieval_basis()[0].to(maps[0].steps.device)
    patches = rig.patches(basis, HALVINGS)
    rotations = _rotations(lines, str(basis.device), max_tilt, config)
    quarter = math.pi / 2
    azimuths = [math.atan2(float(one.axes[0, 1]), float(one.axes[0, 0])) for one in maps]
    turns = [round(azimuth / quarter * _TURNS) % _TURNS for azimuth in azimuths]
    known = sorted(set(turns))
    queries = torch.stack(
        [_vectors_of(patches, _about_z(turn * quarter / _TURNS).to(rotations) @ rotations) for turn in known]
    )
    # So finely that sums of products of them and of steps fit into 32 bits.
    most = torch.iinfo(torch.int32).max // (torch.iinfo(torch.int8).max * queries.shape[-1])
    step = queries.abs().max().clamp_min(1e-9) / most
    queries = (queries / step).round()
    numbers = torch.tensor([known.index(turn) for turn in turns])
    sizes = torch.tensor([len(one) for one in maps], device=queries.device)
    # The best product (N,) of each start of all maps with the vectors of the rig.
    if has_kernels_for(queries):
        best, addresses = queries.new_empty(int(sizes.sum())), torch.tensor([one.steps.data_ptr() for one in maps])
        given = addresses, sizes, sizes.cumsum(0) - sizes, numbers, len(maps)
        call("retrieval_scores", *given, queries.to(torch.int16), *queries.shape[1:], best)
    else:
        pairs = zip(maps, numbers.tolist(), strict=True)
        best = torch.cat([(one.steps.to(queries.dtype) @ queries[number].T).amax(1) for one, number in pairs])
    owner = torch.arange(len(maps), device=best.device).repeat_interleave(sizes)
    scores = best * torch.cat([one.scale for one in maps]) * step
    return scores.new_full((len(maps),), -math.inf).scatter_reduce(0, owner, scores, "amax")


def _rotations(lines: LineSupport | None, device: str, max_tilt: float | None, config: SearchConfig) -> Tensor:
    """Return the rotations (R, 3, 3) axes_from_rig that are tried, tilted no more than allowed where any are not."""
    if lines is None:
        tried = rotations_of(config.rotations_with(2), device)
    else:
        every = rotations_of_axes(config.line_rotations, device)
        tried = turns_of_axes(device) @ every[lines.of_rotations(every).argmax()]
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
