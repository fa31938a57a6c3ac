"""When a search ends, and when aliases are looked up."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy, Hypothesis
from panoloc.core.decide.verdict import Verdict
from panoloc.core.options import Status
from panoloc.core.query import engine as steps
from panoloc.core.query.engine import Engine
from panoloc.core.stage_clock import StageClock

SURE = LocalizerConfig().judge.sure


@pytest.mark.parametrize(
    ("status", "confidences", "ends"),
    [("localized", [SURE, 0.01], True), ("localized", [SURE - 0.01, 0.01], False), ("ambiguous", [0.5, 0.5], False)],
)
def test_one_sure_place_ends_a_search_and_equals_do_not_for_the_right_one_may_be_elsewhere(
    status: Status, confidences: list[float], ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = Engine(LocalizerConfig(), load_confidence_model())
    found = Verdict([], confidences, status, Accuracy(0.01, 0.1))
    monkeypatch.setattr(engine, "_verdict", lambda contest: found)
    contest: Any = SimpleNamespace(hypotheses=["best"])
    assert engine.is_sure(contest) is ends
    contest.hypotheses = []
    assert not engine.is_sure(contest)


@pytest.mark.parametrize(("agreement", "is_asked"), [(0.5, True), (0.05, False)])
def test_aliases_are_looked_up_where_the_best_pose_would_be_told_without_its_rivals(
    agreement: float, is_asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    measures = {"patch_correlation": agreement, "lines": 1.0, "coverage": 0.9}
    best, twin = (
        Hypothesis(0, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=1.0, measures=measures) for x in (0.0, 3.0)
    )
    added: list[Any] = []
    contest: Any = SimpleNamespace(
        hypotheses=[best, twin], queries=["map"], is_guess=False, noise=NO_NOISE, add_aliases=added.extend
    )
    monkeypatch.setattr(steps, "aliases_of_pose", lambda queries, found: [twin] if found is best else [])
    engine, clock = Engine(LocalizerConfig(), load_confidence_model()), StageClock(None, torch.device("cpu"))
    engine._add_aliases(contest, clock)
    assert added == ([twin] if is_asked else [])
    contest.hypotheses = []
    engine._add_aliases(contest, clock)
    assert len(added) == is_asked
