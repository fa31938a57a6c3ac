"""The worker process, `python -m panoloc.service.pool.child`: answers queries, or builds one map, for its service."""

import os
import queue
import sys
import threading
from typing import Any

from panoloc.service.host.logging import configure_logging
from panoloc.service.host.process_resources import return_freed_memory
from panoloc.service.jobs import LocalizeJob, RegisterJob
from panoloc.service.pool.messages import Answer, ChildPipes, Request, Status
from panoloc.service.worker.plan import WorkerPlan

_REGISTRATION_NICENESS = 10
# After this long without a query the worker returns its freed memory; between queries it would only be asked for again.
_IDLE_S = 1.0


def main(what: str = "worker") -> None:
    """Run the worker, or the "builder" of one map, that the first message describes."""
    pipes = ChildPipes()
    plan: WorkerPlan = pipes.receive()
    configure_logging(*plan.log)
    requests: queue.Queue[Request] = queue.Queue()
    cancelled: set[int] = set()

    def take(request: Request) -> None:
        if request.job is None:
            cancelled.add(request.number)
        else:
            requests.put(request)

    threading.Thread(target=pipes.follow, args=(take,), daemon=True).start()
    # The main thread computes: OpenMP keeps a team of threads for each thread that asks, and more teams than cores halve the speed.
    if what == "builder":
        _build(plan, requests.get(), pipes)
    else:
        _answer(plan, requests, cancelled, pipes)


def _answer(plan: WorkerPlan, requests: "queue.Queue[Request]", cancelled: set[int], pipes: ChildPipes) -> None:
    try:
        worker = plan.build_worker()
    except Exception as error:
        pipes.send(Status(problem=f"{type(error).__name__}: {error}"))
        raise
    pipes.send(Status(num_workers=1, capacity=1))
    while True:
        try:
            request = requests.get(timeout=_IDLE_S)
        except queue.Empty:
            return_freed_memory()
            request = requests.get()
        number, job = request.number, request.job
        assert isinstance(job, LocalizeJob), "builds have processes of their own"
        pipes.send(Answer(number, worker.localize(job, lambda number=number: number in cancelled)))  # type: ignore[misc]
        cancelled.discard(number)


def _build(plan: WorkerPlan, request: Any, pipes: ChildPipes) -> None:
    if isinstance(request.job, RegisterJob):
        os.nice(_REGISTRATION_NICENESS)  # queries wait for rebuilds, but not for registrations
        reply: Any = plan.build_registrar().register(request.job)
    else:
        reply = plan.build_registrar().rebuild(request.job)
    pipes.send(Answer(request.number, reply))


if __name__ == "__main__":
    main(*sys.argv[1:])
