"""The process that speaks with a Ray cluster for the service: `python -m panoloc.service.ray.bridge`.

Ray's calls may hang, and a lost cluster may end the process that asks it. So the service gives requests to this process as it gives
them to a local worker, and starts another one when this one ends.
"""

import asyncio
import os
import sys
import threading
import time
from typing import Any

import ray
from ray import serve
from ray.exceptions import RayError, RayTaskError
from ray.serve.exceptions import RayServeException
from ray.serve.handle import DeploymentHandle

from panoloc.service.host.logging import configure_logging
from panoloc.service.jobs import LocalizeJob
from panoloc.service.pool.messages import Answer, ChildPipes, Request, Status
from panoloc.service.ray.application import APPLICATION, BUILDER, REQUESTS_PER_WORKER, description, num_running
from panoloc.service.worker.plan import WorkerPlan, WorkerReply, failure_of

_LOOK_PERIOD_S = 1.0
# Joining a cluster takes 3 to 10 s; then every second somebody answers, or the cluster is away.
_LONGEST_JOIN_S, _LONGEST_SILENCE_S = 120.0, 10.0


class Bridge:
    """Requests on their way to the cluster, and their answers on the way back."""

    def __init__(self, pipes: ChildPipes, localizer: DeploymentHandle, builder: DeploymentHandle) -> None:
        self._pipes = pipes
        self._localizer = localizer
        self._builder = builder
        self._under_way: dict[int, asyncio.Task[None]] = {}

    def take(self, request: Request) -> None:
        """Send a request to the cluster, or cancel one that is there."""
        if request.job is None:
            if request.number in self._under_way:
                self._under_way[request.number].cancel()
            return
        task = asyncio.create_task(self._answer(request))
        self._under_way[request.number] = task
        task.add_done_callback(lambda _: self._under_way.pop(request.number))

    async def _answer(self, request: Request) -> None:
        if isinstance(request.job, LocalizeJob):
            # The router prefers a worker that has these maps in memory, or this share of them.
            maps = request.job.share or ",".join(f"{ref.id}:{ref.revision}" for ref in request.job.maps)
            response = self._localizer.options(multiplexed_model_id=maps).localize.remote(request.job)
        else:
            response = self._builder.build.remote(request.job)
        self._pipes.send(Answer(request.number, await _reply(response)))


async def _reply(response: Any) -> WorkerReply[Any] | None:
    """Return what came back: None when the worker was lost, a failure when our own code raised."""
    try:
        reply: WorkerReply[Any] = await response
        return reply
    except asyncio.CancelledError:
        response.cancel()
        return None
    except RayTaskError as error:
        return WorkerReply(failure=failure_of(error.cause if isinstance(error.cause, Exception) else error))
    except (RayError, RayServeException):
        return None


async def _run(pipes: ChildPipes, watchdog: "Watchdog", plan: WorkerPlan) -> None:
    localizer = serve.get_app_handle(APPLICATION)
    if differences := _differences(await localizer.describe.remote(), description(plan)):
        raise ValueError(f"workers and API replica differ in {differences}; set them to the same value")
    bridge = Bridge(pipes, localizer, serve.get_deployment_handle(BUILDER, APPLICATION))
    loop = asyncio.get_running_loop()

    def take(request: Request) -> None:
        loop.call_soon_threadsafe(bridge.take, request)

    threading.Thread(target=pipes.follow, args=(take,), daemon=True).start()
    published = None
    while True:
        # A call of Ray in another thread: where the cluster is away it hangs, and the watchdog ends this process.
        num_workers = await asyncio.to_thread(num_running)
        watchdog.next_within(_LONGEST_SILENCE_S)
        status = Status(
            num_workers, num_workers * REQUESTS_PER_WORKER, "" if num_workers else "no worker of the cluster is up"
        )
        if status != published:
            pipes.send(status)
            published = status
        await asyncio.sleep(_LOOK_PERIOD_S)


def _differences(theirs: dict[str, str], ours: dict[str, str]) -> str:
    return ", ".join(
        f"{name} ({theirs.get(name)} there, {ours[name]} here)" for name in ours if theirs.get(name) != ours[name]
    )


class Watchdog:
    """Ends this process when Ray has not answered in time."""

    def __init__(self, pipes: ChildPipes, first_s: float) -> None:
        self._pipes = pipes
        self.next_within(first_s)
        threading.Thread(target=self._watch, daemon=True).start()

    def next_within(self, seconds: float) -> None:
        """Expect the next sign of life within so many seconds."""
        self._seconds, self._due = seconds, time.monotonic() + seconds

    def _watch(self) -> None:
        while time.monotonic() < self._due:
            time.sleep(_LOOK_PERIOD_S / 4)
        self._pipes.send(Status(problem=f"the Ray cluster has not answered for {self._seconds:.0f} s"))
        os._exit(1)


def main(address: str) -> None:
    """Join the cluster and serve until the service or the cluster ends."""
    pipes = ChildPipes()
    plan: WorkerPlan = pipes.receive()
    configure_logging(*plan.log)
    watchdog = Watchdog(pipes, _LONGEST_JOIN_S)
    try:
        ray.init(address=address, namespace=APPLICATION, log_to_driver=False, logging_level="ERROR")
        asyncio.run(_run(pipes, watchdog, plan))
    except BaseException as error:
        pipes.send(Status(problem=f"Ray at {address}: {' '.join(str(error).split())[-300:] or type(error).__name__}"))
        os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1])
