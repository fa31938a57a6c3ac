"""Waiting for Ray ends when it is told to. No real Ray."""

import threading
import time
from typing import Any

import pytest
from ray.exceptions import GetTimeoutError

from service.ray.patience import GivenUpError, Patience


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Note what is asked of Ray, which has an answer to `answered` alone, and only the second time."""
    asked: list[Any] = []

    def get(reference: str, timeout: float) -> str:
        asked.append(reference)
        if reference == "answered" and len(asked) > 1:
            return "answer"
        time.sleep(min(0.02, timeout))
        raise GetTimeoutError

    monkeypatch.setattr("ray.get", get)
    return asked


def test_an_answer_that_takes_more_than_one_turn_is_waited_for(asked: list[Any]) -> None:
    assert Patience().gotten("answered") == "answer"
    assert asked == ["answered"] * 2


def test_nobody_waits_longer_than_he_says(asked: list[Any]) -> None:
    with pytest.raises(TimeoutError, match="for 0 s"):
        Patience().gotten("never", 0.1)
    assert asked


def test_the_end_is_one_for_who_waits_and_for_who_comes_until_there_is_a_new_beginning(asked: list[Any]) -> None:
    patience = Patience()
    threading.Timer(0.1, patience.end).start()
    with pytest.raises(GivenUpError):
        patience.gotten("never")
    num_asked = len(asked)
    with pytest.raises(GivenUpError):
        patience.gotten("never")
    assert len(asked) == num_asked
    patience.begin()
    assert patience.gotten("answered") == "answer"
