"""The pool of an API replica whose workers are on a Ray cluster: one process that speaks with the cluster takes all requests."""

import sys
from typing import Any

from panoloc.service.errors import NoWorkerError
from panoloc.service.pool.messages import Build
from panoloc.service.pool.process_pool import ProcessPool
from panoloc.service.pool.worker_process import Work, WorkerLostError
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan
from panoloc.service.worker.reply import WorkerReply, error_of


def bridge_pool(settings: Settings, plan: WorkerPlan) -> "BridgePool":
    """Return the pool of `settings.ray_address`; nothing starts yet."""
    module = f"panoloc.service.ray.bridge {settings.ray_address}"
    return BridgePool(settings, plan, module, [{"RAY_USAGE_STATS_ENABLED": "0"}], sys.maxsize)


class BridgePool(ProcessPool):
    """Queries and builds go to the cluster; the queue, the repeats and the admission are those of every pool."""

    async def _build(self, job: Build) -> WorkerReply[Any]:
        bridge = next((each for each in self._processes if each.status.num_workers), None)
        if bridge is None:
            raise NoWorkerError(f"no worker can take this request: waiting for {self.state().waiting_for}")
        work = Work(next(self._numbers), job)
        bridge.begin(work)
        try:
            reply = await work.future
        except WorkerLostError as lost:
            raise NoWorkerError(f"the worker that builds the map was lost ({lost})") from lost
        finally:
            if work.future.cancelled():
                bridge.cancel(work)
        if reply.failure is not None and isinstance(error := error_of(reply.failure), NoWorkerError):
            raise error
        return reply
