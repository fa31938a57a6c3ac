"""When Serve is told that a replica hangs, so that it is replaced. Without Ray's processes."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from service.ray.remote import LocalizationReplica


@dataclass
class Job:
    deadline_unix_s: float


@dataclass
class HeldWorker:
    """Its own plan; a query begins, and ends when the test lets it."""

    begun: threading.Event = field(default_factory=threading.Event)
    may_end: threading.Event = field(default_factory=threading.Event)
    fails: bool = False

    def build_worker(self) -> "HeldWorker":
        return self

    def localize(self, _: Any) -> str:
        self.begun.set()
        assert self.may_end.wait(10)
        if self.fails:
            raise ZeroDivisionError
        return "answer"


@pytest.fixture
def worker() -> Iterator[HeldWorker]:
    worker = HeldWorker()
    yield worker
    worker.may_end.set()


def computing(worker: HeldWorker, seconds_past_deadline: float) -> tuple[LocalizationReplica, Any]:
    """Return a replica in the middle of a query, and what the query will become."""
    replica = LocalizationReplica(worker)  # type: ignore[arg-type]
    job: Any = Job(time.time() - seconds_past_deadline)
    answer = replica._computing.submit(replica._compute, job)
    assert worker.begun.wait(10)
    return replica, answer


def test_a_replica_whose_query_is_a_minute_past_its_deadline_is_ill(worker: HeldWorker) -> None:
    replica, _ = computing(worker, seconds_past_deadline=75)
    with pytest.raises(RuntimeError, match=r"7[5-9] s past its deadline"):
        replica.check_health()


@pytest.mark.parametrize("seconds_past_deadline", [-30.0, 45.0])
def test_a_replica_is_well_while_its_query_may_still_notice_the_deadline_itself(
    worker: HeldWorker, seconds_past_deadline: float
) -> None:
    replica, _ = computing(worker, seconds_past_deadline)
    replica.check_health()


@pytest.mark.parametrize("fails", [False, True])
def test_a_replica_is_well_again_once_its_late_query_has_ended(worker: HeldWorker, fails: bool) -> None:
    worker.fails = fails
    replica, answer = computing(worker, seconds_past_deadline=75)
    worker.may_end.set()
    if fails:
        with pytest.raises(ZeroDivisionError):
            answer.result(10)
    else:
        assert answer.result(10) == "answer"
    replica.check_health()


def test_a_replica_without_a_query_is_well(worker: HeldWorker) -> None:
    LocalizationReplica(worker).check_health()  # type: ignore[arg-type]
