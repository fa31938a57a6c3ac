"""The pool of an API replica whose workers are on a Ray cluster: one process that speaks with the cluster takes all requests."""

import sys
from typing import Any

from panoloc.service.errors import NoWorkerError
from panoloc.service.pool.messages import Hello, Kind
from panoloc.service.pool.process_pool import ProcessPool
from panoloc.service.pool.worker_process import Work, WorkerProcess
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan
from panoloc.service.worker.reply import WorkerReply, error_of


def bridge_pool(settings: Settings, plan: WorkerPlan) -> "BridgePool":
    """Return the pool of `settings.ray_address`; nothing starts yet."""
    return BridgePool(settings, Hello(plan, (settings.log_level, settings.log_format)))


class BridgePool(ProcessPool):
    """Queries and builds go to the cluster; the queue, the repeats and the admission are those of every pool."""

    def __init__(self, settings: Settings, hello: Hello) -> None:
        def bridge(on_change: Any, on_loss: Any) -> WorkerProcess:
            module = f"panoloc.service.ray.bridge {settings.ray_address}"
            return WorkerProcess(module, hello, on_change, on_loss, {"RAY_USAGE_STATS_ENABLED": "0"})

        super().__init__(hello, [bridge], settings.queue_limit, settings.num_registrations, sys.maxsize)

    async def _build(self, kind: Kind, job: Any) -> WorkerReply[Any]:
        bridge = next((each for each in self._processes if each.num_workers), None)
        if bridge is None:
            raise NoWorkerError(f"no worker can take this request: waiting for {self.state().waiting_for}")
        work = Work(next(self._numbers), kind, job)
        bridge.begin(work)
        try:
            reply = await work.future
        finally:
            if not work.future.done() or work.future.cancelled():
                bridge.cancel(work)
        if reply.failure is not None and isinstance(error := error_of(reply.failure), NoWorkerError):
            raise error
        return reply
