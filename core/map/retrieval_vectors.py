"""Retrieval vectors: what a map shows from each of its starts, in numbers that mean the same in all maps.

The descriptors of a map lie along its own principal directions. These lie along a few that were fitted on other scans
(`panoloc.lab.evaluation.fit_retrieval`), those that vary little counting more than they would. A start takes a kilobyte, so that a thousand
maps are compared with a query before any of their indexes is loaded.
"""

import io
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from zipfile import BadZipFile

import numpy as np
import torch
from torch import Tensor

from panoloc.core.config import SearchConfig
from panoloc.core.errors import IndexFormatError
from panoloc.core.map.map_index import MapIndex

HALVINGS = SearchConfig().halvings(is_wide=True)
"""How often patches are taken together, two by two a side."""
RETRIEVAL_VERSION = 1
"""Of what the vectors mean; rises with every change of the directions."""
_WHITENING = 0.25  # power of the variance that directions are divided by


@dataclass(frozen=True)
class RetrievalVectors:
    """Vectors of T starts: steps (T, P D) int8, D numbers of each of P patches, and scale (T,) float32, which makes scores of all starts
    comparable. axes: (3, 3) float32, axes_from_map, along the walls."""

    steps: Tensor
    scale: Tensor
    axes: Tensor

    def __len__(self) -> int:
        return len(self.steps)

    def to(self, device: torch.device | str) -> "RetrievalVectors":
        """Return the vectors on `device`; the axes stay here, where rotations are chosen by them."""
        return RetrievalVectors(self.steps.to(device), self.scale.to(device), self.axes)

    @property
    def num_bytes(self) -> int:
        """Return the memory of all arrays."""
        return sum(part.numel() * part.element_size() for part in (self.steps, self.scale, self.axes))


@lru_cache(maxsize=1)
def retrieval_basis() -> tuple[Tensor, Tensor]:
    """Read the fitted directions (B, D) of descriptors that all maps share, and how far views spread along each (D,)."""
    with resources.files("panoloc.core.map").joinpath("retrieval_basis.npz").open("rb") as file, np.load(file) as found:
        directions, variance = (torch.from_numpy(found[name].astype(np.float32)) for name in ("directions", "variance"))
    whitening = (variance / variance[0]) ** -_WHITENING
    return directions * whitening, variance * whitening.square()


def retrieval_vectors(index: MapIndex) -> RetrievalVectors:
    """Return the vectors of all starts of a map; of none for a map of labels, which shares no colours with others."""
    device, axes = index.starts.device, index.wall_axes.cpu()
    directions, spread = (part.to(device) for part in retrieval_basis())
    described = index.views.descriptors(HALVINGS)
    if index.labels is not None:
        size = described.values.shape[1] * directions.shape[1]
        return RetrievalVectors(torch.empty((0, size), dtype=torch.int8), torch.empty(0), axes).to(device)
    values = described.values @ (described.basis.T @ directions)
    # So that vectors have the same deviation against what queries show on average.
    variance = (described.weights[..., None] * values.square()).sum(1) @ spread
    step = values.abs().amax((1, 2)).clamp_min(1e-9) / torch.iinfo(torch.int8).max
    steps = (values / step[:, None, None]).round().to(torch.int8)
    return RetrievalVectors(steps.flatten(1), step / variance.sqrt().clamp_min(1e-9), axes)


def encode_retrieval_vectors(vectors: RetrievalVectors) -> bytes:
    """Return the vectors as bytes."""
    with io.BytesIO() as file:
        arrays = {name: getattr(vectors, name).cpu().numpy() for name in ("steps", "scale", "axes")}
        np.savez(file, **arrays)
        return file.getvalue()


def decode_retrieval_vectors(data: bytes, device: torch.device | str = "cpu") -> RetrievalVectors:
    """Return the vectors of bytes made by `encode_retrieval_vectors`. Raises IndexFormatError for anything else."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            parts = [torch.from_numpy(found[name]) for name in ("steps", "scale", "axes")]
    except (ValueError, LookupError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise IndexFormatError(
            f"retrieval vectors: the bytes are damaged ({error}); they are made again from the index"
        ) from error
    vectors = RetrievalVectors(*parts)
    kinds = [part.dtype for part in parts] == [torch.int8, torch.float32, torch.float32]
    if not kinds or vectors.steps.shape[:1] != vectors.scale.shape or vectors.axes.shape != (3, 3):
        raise IndexFormatError("retrieval vectors: the arrays do not fit together; they are made again from the index")
    return vectors.to(device)
