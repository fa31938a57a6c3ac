"""Candidates on their way: nothing is worked out twice, and margins compare like with like."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from panoloc.core.config import JudgeConfig, LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.fast.candidate_stages import CandidateStages
from panoloc.core.prepared_query import MapQuery
from panoloc.core.stage_clock import StageClock

SMALLER = 0.5  # what is judged on the larger rendering has half the score


def placed(x: float, score: float) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis."""
    return Hypothesis(0, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=score)


class Refinement:
    """Stands for the refinement steps: leaves poses as they are and counts them."""

    def __init__(self) -> None:
        self.settled, self.full, self.halved = list[Hypothesis](), list[Hypothesis](), list[Hypothesis]()

    def on_poses(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        self.settled += hypotheses
        return list(hypotheses)

    def fully(self, query: MapQuery, hypothesis: Hypothesis) -> tuple[Hypothesis, Any]:
        self.full.append(hypothesis)
        return hypothesis, SimpleNamespace(of_score=hypothesis.score, patches=torch.zeros(1))

    def with_halves(self, query: MapQuery, hypothesis: Hypothesis, points: Any) -> Hypothesis:
        self.halved.append(hypothesis)
        assert points.of_score == hypothesis.score / SMALLER
        return replace(hypothesis, measures=hypothesis.measures | {"halves_apart_m": 0.01})

    def focal_pull(self, query: MapQuery, hypothesis: Hypothesis, points: Any) -> float:
        assert points.of_score == hypothesis.score / SMALLER
        return hypothesis.score


def stages_of(rivals: int, weighed_places: int = 6) -> tuple[CandidateStages, Refinement]:
    """Return stages with one map, which allows everything, whose judge halves scores at the end."""

    def judge_alone(hypothesis: Hypothesis) -> tuple[Hypothesis, Any]:
        return replace(hypothesis, score=SMALLER * hypothesis.score), None

    query = SimpleNamespace(
        judge=lambda group, height: list(group), judge_alone=judge_alone, allows=lambda h: True, picture=None
    )
    config = replace(LocalizerConfig(), judge=JudgeConfig(rivals=rivals, weighed_places=weighed_places))
    stages = CandidateStages([cast(MapQuery, query)], config, StageClock(None, torch.device("cpu")))
    refinement = Refinement()
    stages.refined = cast(Any, refinement)
    return stages, refinement


def test_what_was_settled_or_refined_fully_is_not_again() -> None:
    stages, refinement = stages_of(rivals=1)
    ranked = [placed(0.0, 1.0), placed(3.0, 0.8)]
    assert stages.settle(ranked[:1]) == ranked[:1]
    assert stages.settle(ranked) == ranked[1:]
    assert refinement.settled == ranked
    for _ in range(2):
        stages.finals(stages.settled[:1], ranked)
    assert refinement.full == ranked[:1]
    assert [h.score for h in refinement.halved] == [0.5]
    assert [h.score for h in stages.settled] == [1.0, 0.8]


def test_where_evidence_ranks_more_places_are_refined_fully_and_the_score_does_not_choose() -> None:
    stages, refinement = stages_of(rivals=1, weighed_places=3)
    ranked = [placed(0.0, 1.0), placed(0.2, 0.9), placed(3.0, 0.8), placed(6.0, 0.7), placed(9.0, 0.6)]
    stages.settle(ranked)
    stages.evidence = lambda h: float(h.position[0]) + h.measures["halves_apart_m"]
    found, _ = stages.finals(stages.settled[:1], ranked)
    # One of each place: what is 0.2 m beside the best says nothing new.
    assert refinement.full == [ranked[0], ranked[2], ranked[3]]
    assert [round(float(h.position[0]), 1) for h in found] == [6.0, 3.0, 0.0, 0.2, 9.0]
    assert len(refinement.halved) == 3


def test_what_comes_back_to_a_place_that_it_was_sought_apart_from_is_no_rival() -> None:
    stages, refinement = stages_of(rivals=1)
    best, back, other = placed(0.0, 1.0), placed(0.6, 0.9), placed(2.0, 0.5)
    stages.settle([best])
    assert stages.settle([back, other], best) == [other]
    assert stages.settled == [best, other]
    assert stages.settle([back, other]) == []  # it is not looked at again either
    assert refinement.settled == [best, back, other]
    found, _ = stages.finals(stages.settled[:1], stages.settled)
    assert [h.score for h in found] == [0.5, 0.25]


@pytest.mark.parametrize("rivals", [1, 2])
def test_rivals_are_judged_as_the_best_is_and_what_is_not_counts_no_more_than_they(rivals: int) -> None:
    stages, _ = stages_of(rivals)
    ranked = [placed(3.0 * k, score) for k, score in enumerate((1.0, 0.8, 0.7, 0.6))]
    stages.settle(ranked)
    found, _ = stages.finals(stages.settled[:1], ranked)
    least = SMALLER * ranked[rivals].score
    assert [h.score for h in found] == [
        0.5,
        *(SMALLER * h.score for h in ranked[1 : 1 + rivals]),
        *[least] * (3 - rivals),
    ]


def test_where_all_came_to_one_place_the_best_judged_before_elsewhere_is_the_rival() -> None:
    stages, _ = stages_of(rivals=3)
    ranked = [placed(0.0, 1.0), placed(0.3, 0.9)]
    stages.settle(ranked)
    found, _ = stages.finals(stages.settled[:1], [*ranked, placed(3.0, 0.6), placed(6.0, 0.5)])
    assert [(round(float(h.position[0]), 1), h.score) for h in found] == [(0.0, 0.5), (3.0, 0.3), (0.3, 0.3)]
