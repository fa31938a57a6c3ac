"""Fits the directions of retrieval vectors to procedural scans: `python -m panoloc.lab.evaluation.fit_retrieval` writes them anew."""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import panoloc.core.map
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import HALVINGS
from panoloc.lab.rooms.capture.scanning import scan_with_truth
from panoloc.lab.rooms.scenes.generator import SceneKind, SceneSpec, build_scene

_SIZE = 8  # numbers of a patch
_WHITENING = 0.25  # power of the variance that directions are divided by
_KINDS: tuple[SceneKind, ...] = ("room", "flat", "bare")
_FIRST_SEED = 40_000
_POINTS = 150_000


def fit_directions(indexes: Iterable[MapIndex]) -> tuple[Tensor, Tensor]:
    """Return the directions (B, D) along which the descriptors of maps vary most, those that vary little longer than they were, and the
    variance along each (D,)."""
    spreads = []
    for index in indexes:
        described = index.views.descriptors(HALVINGS)
        spreads.append((index.views.basis @ described.spreads.mean(0) @ index.views.basis.T).double())
    values, vectors = torch.linalg.eigh(torch.stack(spreads).mean(0))
    directions, variance = vectors[:, -_SIZE:].flip(1).float(), values[-_SIZE:].flip(0).float()
    whitening = (variance / variance[0]) ** -_WHITENING
    return directions * whitening, variance * whitening.square()


def main() -> None:
    """Fit directions and write them where the package reads them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=150, help="how many scans to fit to")
    count = parser.parse_args().maps
    specs = (SceneSpec(_KINDS[number % len(_KINDS)], _FIRST_SEED + number) for number in range(count))
    scans = (scan_with_truth(build_scene(spec), num_points=_POINTS, seed=spec.seed) for spec in specs)
    directions, variance = fit_directions(build_map_index(scan.cloud) for scan in scans)
    path = Path(panoloc.core.map.__path__[0], "retrieval_basis.npz")
    np.savez(path, directions=directions.numpy(), variance=variance.numpy())


if __name__ == "__main__":
    main()
