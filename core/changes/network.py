"""A small network over voxels: which of them belong to something that came or went, and where its middle is.

It looks at no picture, but at what `panoloc.core.changes.voxels` says of each voxel: it learns which changed rays meet in an object and
which in nothing, and where one object ends and the next begins. `python -m panoloc.lab.evaluation.fit_changes` fits it on procedural
rooms.
"""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from panoloc.core.changes.voxels import NUM_FEATURES

WEIGHTS = Path(__file__).with_name("weights.npz")
_WIDTHS = 12, 24, 40
_OUTPUTS = 8  # of what went and of what came: a logit, and the way to the middle in metres along x, y and z


class VoxelNetwork(nn.Module):
    """Three scales of voxels, each half as fine as the one before."""

    def __init__(self) -> None:
        super().__init__()
        fine, middle, coarse = _WIDTHS
        self.fine = _convolutions(NUM_FEATURES, fine)
        self.middle = _convolutions(fine, middle)
        self.coarse = _convolutions(middle, coarse)
        self.middle_again = _convolutions(coarse + middle, middle)
        self.fine_again = _convolutions(middle + fine, fine)
        self.last = nn.Conv3d(fine, _OUTPUTS, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Return (B, 2, 4, X, Y, Z) of features (B, NUM_FEATURES, X, Y, Z): what went and what came; sides are multiples of 4."""
        fine = self.fine(features)
        middle = self.middle(nn.functional.max_pool3d(fine, 2))
        coarse = self.coarse(nn.functional.max_pool3d(middle, 2))
        middle = self.middle_again(torch.cat((nn.functional.interpolate(coarse, scale_factor=2.0), middle), 1))
        fine = self.fine_again(torch.cat((nn.functional.interpolate(middle, scale_factor=2.0), fine), 1))
        out: Tensor = self.last(fine)
        return out.view(len(out), 2, 4, *out.shape[2:])


def fitted_network(path: Path = WEIGHTS) -> VoxelNetwork:
    """Return the network with the weights that come with the package."""
    network = VoxelNetwork()
    with np.load(path) as stored:
        weights = {name: torch.from_numpy(stored[name].astype(np.float32)) for name in stored.files}
    network.load_state_dict(weights, strict=False)  # without the counts of what it was fitted on
    return network.eval()


def _convolutions(inputs: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before in (inputs, outputs):
        layers += [nn.Conv3d(before, outputs, 3, padding=1, bias=False), nn.BatchNorm3d(outputs), nn.ReLU()]
    return nn.Sequential(*layers)


def write_weights(network: VoxelNetwork, path: Path = WEIGHTS) -> None:
    """Write a fitted network in half precision; by default in the place of the one that comes with the package."""
    state = {name: value.numpy() for name, value in network.state_dict().items() if "num_batches" not in name}
    np.savez_compressed(path, **{name: value.astype(np.float16) for name, value in state.items()})
