"""Weights of several fits as one network."""

from pathlib import Path

import torch

from panoloc.core.changes.network import VoxelNetwork, fitted_network, write_weights
from panoloc.lab.evaluation.fit_changes import mean_network


def test_a_network_of_several_fits_has_the_mean_of_their_weights(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.npz" for number in range(3)]
    for number, path in enumerate(paths):
        torch.manual_seed(number)
        write_weights(VoxelNetwork(), path)
    weights = [fitted_network(path).last.weight for path in paths]
    assert not torch.equal(weights[0], weights[1])
    torch.testing.assert_close(mean_network(paths).last.weight, sum(weights) / 3)
