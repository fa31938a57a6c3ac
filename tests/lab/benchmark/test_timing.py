"""Spreads of durations, and what is counted."""

import pytest
import torch

from lab.benchmark.timing import repeated, spread_of, timed

CPU = torch.device("cpu")


def test_a_spread_is_that_of_its_values() -> None:
    spread = spread_of([5.0, 1.0, 3.0, 2.0, 4.0])
    assert (spread.num, spread.median_ms, spread.min_ms, spread.max_ms, spread.mean_ms) == (5, 3, 1, 5, 3)
    assert (spread.lower_quartile_ms, spread.upper_quartile_ms) == (2, 4)
    assert spread.p95_ms == pytest.approx(4.8)


def test_of_one_value_everything_is_that_value() -> None:
    spread = spread_of([7.0])
    assert {spread.median_ms, spread.min_ms, spread.max_ms, spread.mean_ms, spread.p95_ms} == {7.0}


def test_warm_ups_run_and_are_not_counted() -> None:
    calls: list[int] = []
    assert repeated(lambda: calls.append(1), 3, CPU, warm_ups=2).num == 3
    assert len(calls) == 5


def test_timing_hands_the_result_on() -> None:
    milliseconds, result = timed(lambda: "answer", CPU)
    assert result == "answer"
    assert milliseconds >= 0


def test_cuda_is_waited_for_before_and_after(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []
    monkeypatch.setattr(torch.cuda, "synchronize", lambda device: events.append("wait"))
    timed(lambda: events.append("step"), torch.device("cuda"))
    assert events == ["wait", "step", "wait"]
