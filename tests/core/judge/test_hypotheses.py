"""Which hypotheses remain."""

import torch

from core.config import JudgeConfig
from core.judge.hypotheses import Hypothesis, by_score, merged, within_margin

JUDGE = JudgeConfig()


def placed(x: float, score: float = 0.0, loss: float = 0.0, map_number: int = 0) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis."""
    return Hypothesis(map_number, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=score, loss=loss)


def test_of_candidates_that_met_the_one_of_smallest_loss_stays() -> None:
    found = merged(
        [placed(0.0, loss=0.3), placed(0.05, loss=0.1), placed(1.0, loss=0.2), placed(0.05, map_number=1)], JUDGE.merged
    )
    assert [(h.map_number, h.loss) for h in found] == [(1, 0.0), (0, 0.1), (0, 0.2)]


def test_hopeless_candidates_go_but_the_best_one_elsewhere_stays() -> None:
    ranked = [placed(0.0, 1.4), placed(0.2, 1.3), placed(5.0, 0.6), placed(9.0, 0.5)]
    assert [h.score for h in within_margin(ranked, 8, 0.35, JUDGE.place)] == [1.4, 1.3, 0.6]
    close = [placed(0.0, 1.4), placed(5.0, 1.3), placed(9.0, 0.5)]
    assert [h.score for h in within_margin(close, 8, 0.35, JUDGE.place)] == [1.4, 1.3]
    assert [h.score for h in within_margin(ranked, 8, 0.35)] == [1.4, 1.3]
    assert within_margin([], 8, 0.35, JUDGE.place) == []


def test_hypotheses_that_converged_to_one_pose_count_once() -> None:
    near = [Hypothesis(0, k, torch.eye(3), torch.tensor([0.01 * k, 0, 0]), score=0.5 + 0.1 * k) for k in range(4)]
    apart = Hypothesis(0, 9, torch.eye(3), torch.tensor([2.0, 0, 0]), score=0.1)
    elsewhere = Hypothesis(1, 0, torch.eye(3), torch.zeros(3), score=0.2)
    kept = by_score([*near, apart, elsewhere], JUDGE.distinct)
    assert [h.score for h in kept] == [near[3].score, 0.2, 0.1]
