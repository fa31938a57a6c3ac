"""The exception tree is the one that its module draws; stages are timed and stop at the deadline."""

import time

import pytest
import torch

from panoloc.core import errors
from panoloc.core.errors import CoreError, DeadlineExceededError
from panoloc.core.stage_clock import StageClock


def test_every_error_is_an_error_of_core() -> None:
    assert all(issubclass(cls, CoreError) for cls in vars(errors).values() if isinstance(cls, type))


def test_a_stage_used_twice_adds_up() -> None:
    clock = StageClock(None, torch.device("cpu"))
    for _ in range(2):
        with clock.stage("refine"):
            time.sleep(0.01)
    assert 0.02 <= clock.timings_s["refine"] < 2


def test_a_stage_is_timed_also_when_it_fails() -> None:
    clock = StageClock(None, torch.device("cpu"))
    with pytest.raises(ValueError), clock.stage("search"):
        raise ValueError
    assert "search" in clock.timings_s


def test_no_stage_starts_after_the_deadline() -> None:
    clock = StageClock(0.005, torch.device("cpu"))
    time.sleep(0.01)
    with pytest.raises(DeadlineExceededError, match="no pose within"), clock.stage("search"):
        pytest.fail("the stage ran")


def test_half_of_the_time_is_past_when_less_is_left_than_was_used() -> None:
    clock = StageClock(1000.0, torch.device("cpu"))
    assert not clock.is_past_half()
    clock = StageClock(0.04, torch.device("cpu"))
    time.sleep(0.025)
    assert clock.is_past_half()
    assert not StageClock(None, torch.device("cpu")).is_past_half()
