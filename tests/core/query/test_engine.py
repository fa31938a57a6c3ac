"""When a search ends."""

from types import SimpleNamespace
from typing import Any

import pytest

from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.decide.hypotheses import Accuracy
from panoloc.core.decide.verdict import Verdict
from panoloc.core.options import Status
from panoloc.core.query.engine import Engine

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
