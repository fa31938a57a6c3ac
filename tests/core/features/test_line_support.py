"""Vanishing points: how edges agree with turns of the camera."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from panoloc.core.config import LineConfig
from panoloc.core.features.line_support import Edges, LineSupport
from panoloc.core.geometry.rotations import (
    rotation_angle,
    rotation_from_vector,
    uniform_rotations,
)
from tests.core.features.made_edges import edges_along

CONFIG = LineConfig()
AXES_FROM_RIG = rotation_from_vector(torch.tensor([0.2, -0.1, 0.5]))


def test_the_right_turn_is_agreed_with_best_of_all() -> None:
    support = LineSupport(edges_along(AXES_FROM_RIG), CONFIG)
    right = float(support.of_rotations(AXES_FROM_RIG[None]))
    others = uniform_rotations(4000)
    # Turns that only exchange the axes say the same.
    turns = rotations_of_symmetry() @ AXES_FROM_RIG
    off = torch.stack([rotation_angle(others, turn) for turn in turns]).amin(0)
    assert right > 1.5 * float(support.of_rotations(others[off > math.radians(6)]).max())
    torch.testing.assert_close(support.of_rotations(turns), torch.full((24,), right), atol=0.05, rtol=0.05)


def test_the_map_of_vanishing_points_is_the_logarithm_of_the_likelihood_ratio() -> None:
    # Two edges half-way between two axes: one runs to the vanishing point overhead, the other beside it by one standard deviation.
    noise, half = math.radians(CONFIG.edge_noise_deg), math.sqrt(0.5)
    normals = torch.tensor([[-half, half, 0.0], [-half * math.cos(noise), half * math.cos(noise), math.sin(noise)]])
    seen = torch.tensor([[half, half, 0.0]] * 2)
    support = LineSupport(Edges(seen, normals), replace(CONFIG, support_rows=720))
    density = torch.tensor([1.0, math.exp(-0.5)]) / (noise * math.sqrt(2 * math.pi)) * math.pi
    wanted = (1 + CONFIG.aligned_share / 3 * density / (1 - CONFIG.aligned_share)).log().mean()
    # The axes ahead and to the left add nothing: no edge runs that way.
    assert float(support.of_rotations(torch.eye(3)[None])) == pytest.approx(float(wanted), rel=0.03)


def test_without_edges_no_turn_is_better_than_another() -> None:
    support = LineSupport(Edges(torch.zeros((0, 3)), torch.zeros((0, 3))), CONFIG)
    assert support.of_rotations(uniform_rotations(10)).tolist() == [0.0] * 10
    assert support.by_chance == 0.0


def rotations_of_symmetry() -> Tensor:
    """Return the 24 rotations of a cube, by hand."""
    quarter = [rotation_from_vector(torch.eye(3)[axis] * (math.pi / 2)) for axis in range(3)]
    found = [torch.eye(3)]
    for turn in found:
        for step in quarter:
            new = (step @ turn).round()
            if all(not torch.equal(new, other) for other in found):
                found.append(new)
    assert len(found) == 24
    return torch.stack(found)
