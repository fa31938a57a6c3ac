"""The pool of an API replica whose workers are on a Ray cluster: one process that speaks with the cluster takes all requests."""

import sys
from typing import Any

from panoloc.service.errors import NoWorkerError
from panoloc.service.pool.forked_process import start_program
from panoloc.service.pool.messages import Build
from panoloc.service.pool.process_pool import ProcessPool, Variables
from panoloc.service.pool.worker_process import Process, Work, WorkerLostError
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan, WorkerReply, error_of


class BridgePool(ProcessPool):
    """Queries and builds go to the cluster of `settings.ray_address`; the queue, the repeats and the admission are those of every pool."""

    def __init__(self, settings: Settings, plan: WorkerPlan) -> None:
        super().__init__(settings, plan, [{"RAY_USAGE_STATS_ENABLED": "0"}], sys.maxsize)
        self._address = str(settings.ray_address)

    async def _start(self, variables: Variables) -> Process:
        return await start_program("panoloc.service.ray.bridge", self._address, variables=variables)

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
