"""What runs in Ray's processes: the replica that answers queries, and the tasks that build a map's index.

Imported by Ray's workers and, when the pool starts, by the HTTP process; the algorithm is imported by workers alone.
"""

import asyncio
import os
import time
from concurrent.futures import ThreadPoolExecutor

from ray import serve

from service.host.process_resources import return_freed_memory
from service.jobs import LocalizeJob, LocalizeOutcome, MapRef, RegisterJob, RegisterOutcome
from service.worker.plan import WorkerPlan
from service.worker.reply import WorkerReply

_REGISTRATION_NICENESS = 10
# A search checks its deadline often; one that is this late hangs in native code.
_OVERDUE_S = 60.0
_MAPS_KNOWN_TO_ROUTER = 1000
# After this long without a query its memory is given back; while queries come it would only be asked for again.
_IDLE_S = 1.0


class LocalizationReplica:
    """One worker behind a Serve deployment. Computes one query at a time, with all the threads it was given."""

    def __init__(self, plan: WorkerPlan) -> None:
        self._computing = ThreadPoolExecutor(max_workers=1, thread_name_prefix="compute")
        # In the thread that will compute: OpenMP keeps a team of threads for every thread that ever asked for one, and where these
        # are more than the cores, its waits turn from spinning to sleeping, which nearly doubles the time of a query.
        self._worker = self._computing.submit(plan.build_worker).result()
        self._due_unix_s: float | None = None
        self._num_under_way = 0

    async def localize(self, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        """Answer one query after the ones that came before it."""
        await self._mark_resident(serve.get_multiplexed_model_id())
        loop = asyncio.get_running_loop()
        self._num_under_way += 1
        try:
            return await loop.run_in_executor(self._computing, self._compute, job)
        finally:
            self._num_under_way -= 1
            loop.call_later(_IDLE_S, self._tidy_when_idle)

    def check_health(self) -> None:
        """Raise when the query under way should have ended long ago; Serve then replaces this replica."""
        due = self._due_unix_s
        if due is not None and time.time() > due + _OVERDUE_S:
            raise RuntimeError(f"a query is {time.time() - due:.0f} s past its deadline")

    @serve.multiplexed(max_num_models_per_replica=_MAPS_KNOWN_TO_ROUTER)  # type: ignore[untyped-decorator]
    async def _mark_resident(self, map_id: str) -> str:
        # Only tells the router where a map was asked for, so that the next query goes there as well. What is held
        # in memory is the worker's own matter, because it counts bytes and Serve counts models.
        return map_id

    def _tidy_when_idle(self) -> None:
        if not self._num_under_way:
            self._computing.submit(return_freed_memory)

    def _compute(self, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        self._due_unix_s = job.deadline_unix_s
        try:
            return self._worker.localize(job)
        finally:
            self._due_unix_s = None


def register_map(plan: WorkerPlan, job: RegisterJob) -> WorkerReply[RegisterOutcome]:
    """Register one map in a process of its own, so that queries come first and the memory is returned at the end."""
    os.nice(_REGISTRATION_NICENESS)
    return plan.build_registrar().register(job)


def rebuild_map(plan: WorkerPlan, map_ref: MapRef) -> WorkerReply[None]:
    """Build the lost index of one map in a process of its own; queries wait for it, so it is as important as they."""
    return plan.build_registrar().rebuild(map_ref)
