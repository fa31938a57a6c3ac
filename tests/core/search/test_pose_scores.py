"""Candidates among all poses, when many of the best are nearly the same pose or excluded."""

import math

import torch

from panoloc.core.config import SearchConfig
from panoloc.core.geometry.rotations import rotation_from_vector, uniform_rotations
from panoloc.core.search.pose_scores import select_candidates


def poses(num_alike: int, num_elsewhere: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return scores (T, R), starts (T, 3) and rotations (R, 3, 3): the best poses are all alike at the first start, then one
    at each of the other starts, and nothing else is allowed."""
    tiny = torch.linspace(0, 0.01, num_alike)[:, None] * torch.tensor([0.0, 0.0, 1.0])
    scores = torch.full((1 + num_elsewhere, num_alike), -math.inf)
    scores[0] = torch.linspace(2, 1, num_alike)
    scores[1:, 0] = torch.linspace(0.9, 0.5, num_elsewhere)
    starts = torch.zeros((1 + num_elsewhere, 3))
    starts[:, 0] = torch.arange(1 + num_elsewhere) * 2.0
    return scores, starts, torch.stack([rotation_from_vector(turn) for turn in tiny])


def test_when_too_few_of_the_best_poses_differ_more_of_them_are_looked_at() -> None:
    scores, starts, rotations = poses(num_alike=600, num_elsewhere=7)
    found = select_candidates(scores, starts, rotations, SearchConfig(num_candidates=8))
    assert found.starts.tolist() == list(range(8))
    assert found.rotations.tolist() == [0] * 8
    torch.testing.assert_close(found.scores, torch.cat((torch.tensor([2.0]), torch.linspace(0.9, 0.5, 7))))


def test_of_poses_that_hardly_differ_only_the_best_is_a_candidate_however_few_there_are() -> None:
    scores, starts, rotations = poses(num_alike=20, num_elsewhere=2)
    found = select_candidates(scores, starts, rotations, SearchConfig(num_candidates=8))
    assert found.starts.tolist() == [0, 1, 2]
    assert len(found) == 3


def test_the_same_place_seen_another_way_and_another_place_seen_the_same_way_are_other_poses() -> None:
    turned = torch.stack([rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(a)])) for a in (0.0, 24.0, 26.0)])
    starts = torch.tensor([[0.0, 0, 0], [0.7, 0, 0], [0.9, 0, 0]])
    scores = torch.tensor([[9.0, 8.0, 7.0], [6.0, 5.0, 1.0], [4.0, -math.inf, -math.inf]])
    found = select_candidates(scores, starts, turned, SearchConfig(num_candidates=9))
    assert list(zip(found.starts.tolist(), found.rotations.tolist(), strict=True)) == [(0, 0), (0, 2), (2, 0)]


def test_excluded_poses_are_never_candidates() -> None:
    scores = torch.full((3, 5), -math.inf)
    scores[1, 2] = 0.5
    chosen = select_candidates(scores, torch.zeros((3, 3)), uniform_rotations(5), SearchConfig(num_candidates=4))
    assert (chosen.starts.tolist(), chosen.rotations.tolist()) == ([1], [2])
