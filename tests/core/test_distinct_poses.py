"""Which of many poses are different ones, beside the rule taken literally."""

import pytest
import torch
from torch import Tensor

from panoloc.core.config import PoseDistance
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import uniform_rotations

NEAR = PoseDistance(0.8, 60.0)


def literally(rotations: Tensor, positions: Tensor, groups: Tensor | None, count: int | None) -> list[int]:
    kept: list[int] = []
    for number in range(len(rotations)):
        if len(kept) == count:
            break
        for other in kept:
            angle = torch.arccos(((rotations[number].T @ rotations[other]).trace() - 1).clamp(-2, 2) / 2).rad2deg()
            is_one = groups is None or groups[number] == groups[other]
            if is_one and float((positions[number] - positions[other]).norm()) < 0.8 and float(angle) < 60.0:
                break
        else:
            kept.append(number)
    return kept


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 12, 150])
@pytest.mark.parametrize("count", [None, 7])
@pytest.mark.parametrize("is_grouped", [False, True])
def test_none_is_near_one_before_it_that_was_kept(number: int, count: int | None, is_grouped: bool) -> None:
    rng = torch.Generator().manual_seed(number)
    rotations = uniform_rotations(576)[torch.randint(0, 576, (number,), generator=rng)].double()
    positions = 2 * torch.rand((number, 3), generator=rng, dtype=torch.float64)
    groups = torch.randint(0, 3, (number,), generator=rng) if is_grouped else None
    kept = first_distinct(rotations, positions, NEAR, groups, count)
    assert kept == literally(rotations, positions, groups, count)
    assert number < 150 or len(kept) < number
