"""Stages are timed and stop at the deadline."""

import itertools
from types import SimpleNamespace

import pytest
import torch

from panoloc.core.errors import DeadlineExceededError
from panoloc.core.stage_clock import StageClock

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _a_second_passes_whenever_somebody_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = itertools.count(100.0)
    monkeypatch.setattr("panoloc.core.stage_clock.time", SimpleNamespace(monotonic=lambda: next(seconds)))


def test_a_stage_used_twice_adds_up_also_when_it_fails() -> None:
    clock = StageClock(None, CPU)
    with clock.stage("refine"):
        pass
    with pytest.raises(ValueError), clock.stage("refine"):
        raise ValueError
    assert clock.timings_s == {"refine": 2.0}


def test_no_stage_starts_after_the_deadline() -> None:
    clock = StageClock(0.5, CPU)
    with pytest.raises(DeadlineExceededError, match="no pose within"), clock.stage("search"):
        pytest.fail("the stage ran")


def test_no_stage_starts_for_an_answer_that_nobody_waits_for() -> None:
    answers = iter([False, True])
    clock = StageClock(None, CPU, lambda: next(answers))
    with clock.stage("prepare"):
        pass
    with pytest.raises(DeadlineExceededError, match="cancelled"), clock.stage("search"):
        pytest.fail("the stage ran")
