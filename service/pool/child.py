"""The worker process: `python -m panoloc.service.pool.child`. Answers queries, or builds one map, for the service that
started it."""

import os
import queue
import sys
import threading

from panoloc.service.host.logging import configure_logging
from panoloc.service.host.process_resources import return_freed_memory
from panoloc.service.pool.messages import Answer, ChildPipes, Hello, Request, Status

BUILDER = "builder"
"""The argument of a process that builds one map; it gives way to queries when it registers."""

_REGISTRATION_NICENESS = 10
# After this long without a query the worker returns its freed memory; between queries it would only be asked for again.
_IDLE_S = 1.0


def main() -> None:
    """Run the worker, or the builder, that the first message describes."""
    pipes = ChildPipes()
    hello: Hello = pipes.receive()
    configure_logging(*hello.log)
    requests: queue.Queue[Request] = queue.Queue()
    threading.Thread(target=pipes.follow, args=(requests.put,), daemon=True).start()
    # The main thread computes: OpenMP keeps a team of threads for each thread that asks, and more teams than cores halve the speed.
    if BUILDER in sys.argv:
        _build(hello, requests.get(), pipes)
    else:
        _answer(hello, requests, pipes)


def _answer(hello: Hello, requests: "queue.Queue[Request]", pipes: ChildPipes) -> None:
    try:
        worker = hello.plan.build_worker()
    except Exception as error:
        pipes.send(Status(0, 0, f"{type(error).__name__}: {error}"))
        raise
    pipes.send(Status(num_workers=1, capacity=1))
    while True:
        try:
            request = requests.get(timeout=_IDLE_S)
        except queue.Empty:
            return_freed_memory()
            request = requests.get()
        pipes.send(Answer(request.number, worker.localize(request.job)))


def _build(hello: Hello, request: Request, pipes: ChildPipes) -> None:
    if request.kind == "register":
        os.nice(_REGISTRATION_NICENESS)
    registrar = hello.plan.build_registrar()
    build = registrar.register if request.kind == "register" else registrar.rebuild
    pipes.send(Answer(request.number, build(request.job)))


if __name__ == "__main__":
    main()
