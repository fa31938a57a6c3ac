"""The replica that Ray runs, without Ray."""

import threading
from typing import Any

from service.ray.remote import LocalizationReplica


class Plan:
    """Notes the threads in which the worker is built and asked."""

    def __init__(self) -> None:
        self.built_in = self.asked_in = ""

    def build_worker(self) -> "Plan":
        self.built_in = threading.current_thread().name
        return self

    def localize(self, job: Any) -> str:
        self.asked_in = threading.current_thread().name
        return "answer"


def test_the_worker_computes_in_the_thread_that_built_it() -> None:
    plan = Plan()
    replica = LocalizationReplica(plan)  # type: ignore[arg-type]
    job = type("Job", (), {"deadline_unix_s": 0.0})()
    answer: object = replica._computing.submit(replica._compute, job).result()
    assert answer == "answer"
    assert plan.built_in == plan.asked_in
    assert plan.built_in != threading.main_thread().name
