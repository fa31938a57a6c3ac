"""A small network over voxels: where the middles of things are that came or went, how large these are, and which voxels belong to them.

It looks at no picture, but at what `panoloc.core.changes.voxels` says of each voxel: it learns which changed rays meet in an object and
which in nothing, and where one object ends and the next begins. `python -m panoloc.lab.evaluation.fit_changes` fits it on procedural
rooms.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from panoloc.core.changes.voxels import NUM_FEATURES

WEIGHTS = Path(__file__).with_name("weights.npz")
CELL = 2  # voxels along each side of a cell that the network says something of
MULTIPLE = 8  # of which the voxels along each side of what it sees are one
OUTPUTS = 8
"""Of a cell, for what went and for what came: logits that the middle of one is near, and that it belongs to one; the way to the middle,
metres; logarithms of the sides of its box, metres."""
_WIDTHS = 16, 32, 48, 48


class VoxelNetwork(nn.Module):
    """Four scales of voxels, each half as fine as the one before; the finest is only looked at."""

    def __init__(self) -> None:
        super().__init__()
        finest, fine, middle, coarse = _WIDTHS
        self.finest = _convolutions(NUM_FEATURES, finest)
        self.fine = _convolutions(finest, fine, fine)
        self.middle = _convolutions(fine, middle, middle)
        self.coarse = _convolutions(middle, coarse, coarse)
        self.middle_again = _convolutions(coarse + middle, middle)
        self.fine_again = _convolutions(middle + fine, fine, fine)
        self.last = nn.Conv3d(fine, 2 * OUTPUTS, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Return (B, 2, OUTPUTS, X / CELL, ...) of features (B, NUM_FEATURES, X, Y, Z): what went and what came."""
        fine = self.fine(nn.functional.max_pool3d(self.finest(features), CELL))
        middle = self.middle(nn.functional.max_pool3d(fine, 2))
        coarse = self.coarse(nn.functional.max_pool3d(middle, 2))
        middle = self.middle_again(torch.cat((nn.functional.interpolate(coarse, scale_factor=2.0), middle), 1))
        fine = self.fine_again(torch.cat((nn.functional.interpolate(middle, scale_factor=2.0), fine), 1))
        out: Tensor = self.last(fine)
        return out.view(len(out), 2, OUTPUTS, *out.shape[2:])


def fitted_network(path: Path = WEIGHTS) -> VoxelNetwork:
    """Return the network with the weights that come with the package."""
    network = VoxelNetwork()
    with np.load(path) as stored:
        weights = {name: torch.from_numpy(stored[name].astype(np.float32)) for name in stored.files}
    network.load_state_dict(weights, strict=False)  # without the counts of what it was fitted on
    return network.eval()


def _convolutions(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Conv3d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm3d(outputs), nn.ReLU()]
    return nn.Sequential(*layers)


def write_weights(network: VoxelNetwork, path: Path = WEIGHTS) -> None:
    """Write a fitted network in half precision; by default in the place of the one that comes with the package."""
    state = {name: value.numpy() for name, value in network.state_dict().items() if "num_batches" not in name}
    np.savez_compressed(path, **{name: value.astype(np.float16) for name, value in state.items()})
