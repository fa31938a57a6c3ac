"""Which candidates are looked at first."""

import math
from dataclasses import replace

import torch

from core.config import PhotoRefinementConfig, SearchConfig
from core.fast.candidates import most_promising, portions
from core.geometry.rotations import rotation_from_vector
from core.judge.hypotheses import Hypothesis

CONFIG = replace(SearchConfig(), first_portion=3, first_elsewhere=2)


def candidate(x_m: float, turn_deg: float = 0.0, map_number: int = 0) -> Hypothesis:
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(turn_deg)]))
    return Hypothesis(map_number, 0, turn, torch.tensor([x_m, 0.0, 0.0]))


def test_a_room_that_looks_the_same_is_looked_at_with_the_best() -> None:
    here = [candidate(0.1 * k) for k in range(6)]
    there, behind = candidate(9.0), candidate(0.0, turn_deg=120)
    first, rest = portions([*here, there, behind], CONFIG)
    assert first == [*here[:3], there, behind]
    assert rest == here[3:]


def test_none_are_fetched_from_behind_where_the_best_are_at_different_places() -> None:
    found = [candidate(3.0 * k) for k in range(6)]
    first, rest = portions(found, CONFIG)
    assert first == found[:3]
    assert rest == found[3:]


def test_half_of_many_candidates_go_on_and_all_of_few() -> None:
    found = [replace(candidate(float(k)), loss=float(k * 7 % 24)) for k in range(24)]
    config = PhotoRefinementConfig(rough_kept_share=0.5, rough_kept=10)
    assert [each.loss for each in most_promising(found, config)] == [float(k) for k in range(12)]
    assert {each.loss for each in most_promising(found[:9], config)} == {each.loss for each in found[:9]}
