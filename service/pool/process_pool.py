"""The worker pool: processes that the service starts and supervises, and the queue of queries in front of them."""

import asyncio
import heapq
import itertools
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from panoloc.core.config import SearchConfig
from panoloc.core.errors import DeadlineExceededError
from panoloc.service.errors import NoWorkerError
from panoloc.service.host.process_resources import num_sockets, usable_memory_bytes, visible_gpus
from panoloc.service.jobs import (
    LocalizeJob,
    LocalizeOutcome,
    MapRef,
    PoolState,
    QueryImage,
    QueryOptions,
    RegisterJob,
    RegisterOutcome,
    at_once,
)
from panoloc.service.pool.admission import Admission
from panoloc.service.pool.forked_process import ForkServer
from panoloc.service.pool.map_builds import MapBuilds, time_limit
from panoloc.service.pool.messages import Build
from panoloc.service.pool.shares import shares_of
from panoloc.service.pool.worker_process import Process, Work, WorkerLostError, WorkerProcess, run_build
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan, WorkerReply, error_of

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

_MAX_ATTEMPTS, _MAX_REBUILDS = 4, 2
_SEARCH = SearchConfig()
_WATCH_PERIOD_S = 1.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 10.0
_DRAIN_POLL_S = 0.05
# The rest is for the service, Redis and a registration. A worker beyond its share is replaced before the system ends something else.
_WORKERS_SHARE = 0.8

Variables = Mapping[str, str]
"""For the environment of a process."""


def local_pool(settings: Settings, plan: WorkerPlan) -> "ProcessPool":
    """Return the default pool: one worker per GPU, or per CPU socket where there is none. Nothing starts yet."""
    gpus = visible_gpus()
    num_workers = settings.num_workers or len(gpus) or num_sockets()
    plan = replace(plan, workers_per_machine=num_workers)
    environments = [{"CUDA_VISIBLE_DEVICES": gpus[number % len(gpus)]} if gpus else {} for number in range(num_workers)]
    memory_bytes = int(_WORKERS_SHARE * usable_memory_bytes() / num_workers)
    return ProcessPool(settings, plan, environments, memory_bytes)


class ProcessPool:
    """Implements `panoloc.service.jobs.WorkerPool`. Used from one event loop.

    A query goes to a worker that has its maps in memory, where one is free. It waits in the order of arrival. One whose worker is lost
    keeps its number, so it comes first.
    """

    def __init__(
        self, settings: Settings, plan: WorkerPlan, environments: Sequence[Variables], memory_bytes: int
    ) -> None:
        """environments: of each process.

        memory_bytes: resident memory of one process, beyond which it is replaced.
        """
        self._plan = plan
        self._fork_server = ForkServer(plan.modules)
        self._environments = environments
        self._memory_bytes = memory_bytes
        self.admission = Admission(settings.queue_limit)
        self._builds = MapBuilds(self._build, settings.num_registrations)
        self._processes: list[WorkerProcess] = []
        self._queue: list[Work] = []
        self._numbers = itertools.count()
        self._supervisors: list[asyncio.Task[None]] = []
        self._draining = False
        # Why no query is taken. While a worker is replaced there is no reason: queries wait for the next one.
        self._problem = "none has started yet"
        self._resident_bytes: dict[str, int] = {}
        self._index_loads: Counter[str] = Counter()
        self._num_retries = 0

    async def start(self) -> None:
        """Begin to bring the workers up and return at once; `state` tells when they are."""
        self._supervisors = [asyncio.create_task(self._supervise(each)) for each in self._environments]
        self._supervisors.append(asyncio.create_task(self._watch()))

    async def stop(self, drain_s: float) -> None:
        """Take nothing more, wait up to `drain_s` for what is under way, then end the workers."""
        self.begin_drain()
        deadline = time.monotonic() + drain_s
        while self.num_under_way and time.monotonic() < deadline:
            await asyncio.sleep(_DRAIN_POLL_S)
        await self._builds.cancel()
        for task in self._supervisors:
            task.cancel()
        await asyncio.gather(*self._supervisors, return_exceptions=True)
        await self._fork_server.stop()
        self._refuse_waiting("the service is stopped")

    @property
    def num_under_way(self) -> int:
        """Return how many queries wait or run."""
        return self.admission.num_admitted

    def begin_drain(self) -> None:
        """Refuse new requests from now on; those under way go on."""
        self._draining = True

    def state(self) -> PoolState:
        """Return what readiness and metrics publish about the pool."""
        waiting_for = None if self._num_workers else "workers" + (f" ({self._problem})" if self._problem else "")
        if self._draining:
            waiting_for = "its end: the service is shutting down"
        return PoolState(
            ready=waiting_for is None,
            waiting_for=waiting_for,
            num_workers=self._num_workers,
            queue_depth=self.admission.queue_depth,
            resident_bytes=sum(self._resident_bytes.values()),
            index_loads=dict(self._index_loads),
            num_retries=self._num_retries,
        )

    def require_place(self, longest_s: float) -> None:
        """Raise QueueFullError where a query would be refused whatever it asks; see `WorkerPool.require_place`."""
        # Other reasons for a refusal have another status; `localize` gives it.
        if self._is_open:
            self.admission.require_place(longest_s)

    async def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        """Answer one query on some worker; see `WorkerPool.localize` for the errors."""
        self._require_workers()
        remaining_s = job.deadline_unix_s - time.time()
        too_late = DeadlineExceededError("no answer within timeout_s; allow more time, or narrow the search with hints")
        with self.admission.admit(job.kind, remaining_s):
            async with time_limit(max(0.0, remaining_s), too_late):
                left_out: dict[MapRef, Exception] = {}
                asked = job
                if self._num_workers > 1 and len(job.maps) > _SEARCH.most_maps:
                    job = await self._likeliest(job, left_out)
                if job.maps:
                    job, reply = await self._with_indexes(job, left_out)
                if not job.maps:
                    raise next(iter(left_out.values()))
                if reply.view:
                    reply = await self._beside_look_alikes(asked, job, reply, left_out)
                self.admission.note_duration(reply.duration_s, job.kind)
                return _outcome(reply).without_maps(left_out)

    async def _likeliest(self, job: LocalizeJob, left_out: dict[MapRef, Exception]) -> LocalizeJob:
        """Return the query with those of its maps alone that may be searched, best first."""
        scored = await self._scored(job, left_out)
        return replace(job, maps=tuple(ref for _, ref in scored[: _SEARCH.most_maps]), num_maps=len(scored))

    async def _beside_look_alikes(
        self,
        asked: LocalizeJob,
        searched: LocalizeJob,
        reply: WorkerReply[LocalizeOutcome],
        left_out: dict[MapRef, Exception],
    ) -> WorkerReply[LocalizeOutcome]:
        """Return the reply to a query that was found in one of its maps, sought anew beside those that look the same, if there are any."""
        view = replace(
            asked, images=(QueryImage(reply.view),), options=QueryOptions(asked.options.timeout_s), along_walls=True
        )
        scored = await self._scored(view, left_out)
        found = _outcome(reply).answer.map_id
        number = next(number for number, (_, ref) in enumerate(scored) if ref.id == found)
        alike = [scored[other][1] for other in _SEARCH.look_alikes([score for score, _ in scored], number)]
        if not alike:
            return reply
        return (await self._with_indexes(replace(searched, maps=(scored[number][1], *alike)), left_out))[1]

    async def _scored(self, job: LocalizeJob, left_out: dict[MapRef, Exception]) -> list[tuple[float, MapRef]]:
        """Return the maps of a query, best first, and their scores: each worker scores a share of all."""
        parts = shares_of(job.maps, self._num_workers)
        asked = [replace(job, maps=maps, share=f"share {number}") for number, maps in parts.items()]
        scored: list[tuple[float, MapRef]] = []
        for share, reply in await asyncio.gather(*(self._with_indexes(each, left_out) for each in asked)):
            _require_success(reply)
            scored += zip(reply.scores, share.maps, strict=True)
        return sorted(scored, key=lambda pair: -pair[0])

    async def _with_indexes(
        self, job: LocalizeJob, left_out: dict[MapRef, Exception]
    ) -> tuple[LocalizeJob, WorkerReply[LocalizeOutcome]]:
        """Return the reply to a query once no index is missing, and the query without the maps whose index cannot be built, which are added
        to `left_out` with what was raised."""
        number, num_rebuilds = next(self._numbers), 0
        while num_rebuilds <= _MAX_REBUILDS:
            reply = await self._reply_to(number, job)
            if not reply.missing:
                return job, reply
            failed = await self._builds.rebuild(reply.missing)
            num_rebuilds += not failed
            left_out |= failed
            job = replace(job, maps=tuple(ref for ref in job.maps if ref not in failed))
            if not job.maps:
                return job, reply
        raise NoWorkerError(f"Redis does not keep the index of {job.maps[0].id}; check its maxmemory")

    async def register(self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once) -> RegisterOutcome:
        """Build and store a map's index in a process of its own, after the registrations that came before it."""
        self._require_workers()
        return _outcome(await self._builds.register(job, begin))

    @property
    def _num_workers(self) -> int:
        return sum(process.status.num_workers for process in self._processes)

    @property
    def _is_open(self) -> bool:
        return not self._draining and not self._problem

    def _require_workers(self) -> None:
        if not self._is_open:
            raise NoWorkerError(f"no worker can take this request: waiting for {self.state().waiting_for or 'workers'}")

    async def _reply_to(self, number: int, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        """Return the reply of a worker. A query changes nothing, so it is repeated when its worker was lost, a few times."""
        how = ""
        for attempt in range(_MAX_ATTEMPTS):
            if self._problem:
                raise NoWorkerError(f"no worker can take this request: {self._problem}")
            self._num_retries += attempt > 0
            work = Work(number, job)
            heapq.heappush(self._queue, work)
            self._hand_out()
            try:
                reply = await work.future
            except asyncio.CancelledError:
                for process in self._processes:
                    if process.under_way.get(work.number) is work:
                        process.cancel(work)
                raise
            except WorkerLostError as lost:
                how = str(lost)
                self._resident_bytes.clear()
                _log.warning("a worker was lost with a query", extra={"request_id": job.request_id, "error": how})
                continue
            self._resident_bytes[reply.worker] = reply.resident_bytes
            self._index_loads.update(reply.index_loads)
            return reply
        raise NoWorkerError(f"{_MAX_ATTEMPTS} workers in a row were lost while answering this query ({how})")

    def _hand_out(self) -> None:
        """Give waiting queries to processes with room."""
        while self._queue and (
            free := [each for each in self._processes if len(each.under_way) < each.status.capacity]
        ):
            work = heapq.heappop(self._queue)
            if not work.future.done():
                max(free, key=lambda each: (work.maps <= each.known_maps, -len(each.under_way))).begin(work)

    def _note_change(self) -> None:
        if num_workers := self._num_workers:
            self.admission.set_num_workers(num_workers)
            if self._problem:
                _log.info("the workers are ready", extra={"workers": num_workers})
            self._problem = ""
        self._hand_out()

    async def _start(self, variables: Variables) -> Process:
        return await self._fork_server.start("worker", variables)

    async def _supervise(self, environment: Variables) -> None:
        """Keep one process running: start another when it has ended, after a pause when it ended before it was ready."""
        pause_s = _FIRST_PAUSE_S
        while True:
            process = WorkerProcess(self._plan, lambda: self._start(environment), self._note_change)
            self._processes.append(process)
            try:
                how = await process.run()
            except OSError as error:  # no memory for another process
                how = str(error)
            finally:
                self._processes.remove(process)
            problem = process.status.problem
            _log.warning("a worker process ended; the service starts another", extra={"error": problem or how})
            if process.was_ready:
                pause_s = _FIRST_PAUSE_S
                continue
            # One that was killed while it started is no sign that others will not start.
            if problem or pause_s > _FIRST_PAUSE_S:
                self._refuse_waiting(problem or how)
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _refuse_waiting(self, problem: str) -> None:
        """Let no query wait for workers that do not start."""
        if not self._num_workers:
            self._problem = problem
            while self._queue:
                self._queue.pop().fail(NoWorkerError(f"no worker can take this request: {problem}"))

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(_WATCH_PERIOD_S)
            for process in self._processes:
                process.end_if_astray(self._memory_bytes)

    async def _build(self, job: Build) -> WorkerReply[Any]:
        return await run_build(self._plan, job, self._fork_server)


def _outcome(reply: WorkerReply[Result]) -> Result:
    _require_success(reply)
    assert reply.outcome is not None
    return reply.outcome


def _require_success(reply: WorkerReply[Any]) -> None:
    """Raise what the worker raised."""
    if reply.failure is not None:
        if reply.failure.traceback:
            _log.error("a worker failed unexpectedly", extra={"origin": reply.failure.traceback})
        raise error_of(reply.failure)
