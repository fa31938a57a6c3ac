"""Retrieval vectors: what a map shows from each of its starts, in numbers that mean the same in all maps.

What covers much of the sphere is told by its patches. The descriptors of a map lie along its own principal directions; these lie along a
few that were fitted on other scans (`panoloc.lab.evaluation.fit_retrieval`), those that vary little counting more than they would. What
shows little has few patches, and is told by large pixels: one brightness and two differences of colours, of logarithms, so that exposure
and white balance move all pixels of a photo alike. A start takes two kilobytes, so that a thousand maps are compared with a query before
any of their indexes is loaded.
"""

import io
import math
from dataclasses import astuple, dataclass, fields
from functools import lru_cache
from importlib import resources
from zipfile import BadZipFile

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, normalize

from panoloc.core.config import CONTRAST, SearchConfig
from panoloc.core.errors import IndexFormatError
from panoloc.core.map.map_index import MapIndex

HALVINGS = SearchConfig().halvings(is_wide=True)
"""How often patches are taken together, two by two a side."""
RETRIEVAL_VERSION = 2
"""Of what the vectors mean; rises with every change of the directions, the pixels or their levels."""
ROWS = 12  # of the pixels; of 8 a photo is found half as often, of 16 as often
UNSEEN = torch.iinfo(torch.int8).min
"""The level of each channel of a pixel in which a start sees nothing."""
# Differences of colours count three times: furniture and shadows change brightness more.
_CHANNELS = ((1, 1, 1), (1, -1, 0), (1, 1, -2)), (1, 3, 3)


@dataclass(frozen=True)
class RetrievalVectors:
    """Vectors of T starts: steps (T, P D) int8, D numbers of each of P patches, and scale (T,) float32, which makes scores of all starts
    comparable; levels (S, 3, T) int8 of the pixels of a sphere of `ROWS` rows, or UNSEEN. axes: (3, 3) float32, axes_from_map, along the
    walls."""

    steps: Tensor
    scale: Tensor
    levels: Tensor
    axes: Tensor

    def __len__(self) -> int:
        return len(self.steps)

    def to(self, device: torch.device | str) -> "RetrievalVectors":
        """Return the vectors on `device`; the axes stay here, where rotations are chosen by them."""
        return RetrievalVectors(self.steps.to(device), self.scale.to(device), self.levels.to(device), self.axes)

    @property
    def num_bytes(self) -> int:
        """Return the memory of all arrays."""
        return sum(part.numel() * part.element_size() for part in astuple(self))


@lru_cache(maxsize=1)
def retrieval_basis() -> tuple[Tensor, Tensor]:
    """Read the fitted directions (B, D) of descriptors that all maps share, and how far views spread along each (D,)."""
    with resources.files("panoloc.core.map").joinpath("retrieval_basis.npz").open("rb") as file, np.load(file) as found:
        return torch.from_numpy(found["directions"]), torch.from_numpy(found["variance"])


def levels_of(colors: Tensor) -> Tensor:
    """Return the levels (..., 3) int8, brightness first, of colours (..., 3) in 0..1; each brightness has one, from black to white."""
    directions, factors = (torch.tensor(part, dtype=torch.float32, device=colors.device) for part in _CHANNELS)
    values = (colors + CONTRAST.darkest).log() @ (normalize(directions, dim=1) * factors[:, None]).T
    black, white = (math.sqrt(3) * math.log(color + CONTRAST.darkest) for color in (0.0, 1.0))
    values[..., 0] -= (black + white) / 2
    most = torch.iinfo(torch.int8).max
    return (values * (2 * most / (white - black))).round().clamp(-most, most).to(torch.int8)


def retrieval_vectors(index: MapIndex) -> RetrievalVectors:
    """Return the vectors of all starts of a map; of none for a map of labels, which shares no colours with others."""
    device, axes = index.starts.device, index.wall_axes.cpu()
    directions, spread = (part.to(device) for part in retrieval_basis())
    described = index.views.descriptors(HALVINGS)
    if index.labels is not None:
        steps = torch.empty((0, described.values.shape[1] * directions.shape[1]), dtype=torch.int8)
        levels = torch.empty((2 * ROWS * ROWS, 3, 0), dtype=torch.int8)
        return RetrievalVectors(steps, torch.empty(0), levels, axes).to(device)
    values = described.values @ (described.basis.T @ directions)
    # So that vectors have the same deviation against what queries show on average.
    variance = (described.weights[..., None] * values.square()).sum(1) @ spread
    step = values.abs().amax((1, 2)).clamp_min(1e-9) / torch.iinfo(torch.int8).max
    steps = (values / step[:, None, None]).round().to(torch.int8)
    return RetrievalVectors(steps.flatten(1), step / variance.sqrt().clamp_min(1e-9), _levels_of_starts(index), axes)


def _levels_of_starts(index: MapIndex) -> Tensor:
    """Return the levels (S, 3, T) of large pixels of the starts' pictures; those count that are half full or more."""
    seen = index.views.seen[:, None].float()
    size = ROWS, 2 * ROWS
    share = adaptive_avg_pool2d(seen, size)
    colors = adaptive_avg_pool2d(index.views.pictures.permute(0, 3, 1, 2) / 255 * seen, size)
    levels = levels_of((colors / share.clamp_min(1e-6)).permute(0, 2, 3, 1))
    levels = levels.masked_fill(share.permute(0, 2, 3, 1) < 0.5, UNSEEN)
    return levels.flatten(1, 2).permute(1, 2, 0).contiguous()


def encode_retrieval_vectors(vectors: RetrievalVectors) -> bytes:
    """Return the vectors as bytes."""
    with io.BytesIO() as file:
        np.savez(file, **{part.name: getattr(vectors, part.name).cpu().numpy() for part in fields(vectors)})
        return file.getvalue()


def decode_retrieval_vectors(data: bytes, device: torch.device | str = "cpu") -> RetrievalVectors:
    """Return the vectors of bytes made by `encode_retrieval_vectors`. Raises IndexFormatError for anything else."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            vectors = RetrievalVectors(*(torch.from_numpy(found[part.name]) for part in fields(RetrievalVectors)))
    except (ValueError, LookupError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise IndexFormatError(
            f"retrieval vectors: the bytes are damaged ({error}); they are made again from the index"
        ) from error
    count, kinds = len(vectors), [part.dtype for part in astuple(vectors)]
    shapes = [vectors.steps.shape[:1], vectors.scale.shape, vectors.levels.shape, vectors.axes.shape]
    if kinds != [torch.int8, torch.float32] * 2 or shapes != [(count,), (count,), (2 * ROWS * ROWS, 3, count), (3, 3)]:
        raise IndexFormatError("retrieval vectors: the arrays do not fit together; they are made again from the index")
    return vectors.to(device)
