"""The worker pool: processes that the service starts and supervises, and the queue of queries in front of them."""

import asyncio
import contextlib
import heapq
import itertools
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Any, TypeVar

from panoloc.core.errors import DeadlineExceededError
from panoloc.service.errors import NoWorkerError
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, PoolState, RegisterJob, RegisterOutcome, at_once
from panoloc.service.pool.admission import Admission
from panoloc.service.pool.map_builds import MapBuilds
from panoloc.service.pool.messages import Hello, Kind
from panoloc.service.pool.one_build import run_build
from panoloc.service.pool.worker_process import Work, WorkerProcess
from panoloc.service.worker.reply import WorkerReply, error_of

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

_MAX_REBUILDS = 2
_WATCH_PERIOD_S = 1.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 10.0
_DRAIN_POLL_S = 0.05

Seat = Callable[[Callable[[], None], Callable[[Work, str], None]], WorkerProcess]
"""Makes one process of the pool, whenever it has to be started; called with `on_change` and `on_loss`."""


class ProcessPool:
    """Implements `panoloc.service.jobs.WorkerPool`. Used from one event loop.

    A query goes to a worker that has its maps in memory, where one is free. It waits in the order of arrival. One whose worker is lost
    keeps its number, so it comes first.
    """

    def __init__(
        self, hello: Hello, seats: Sequence[Seat], queue_limit: int, num_registrations: int, memory_bytes: int
    ) -> None:
        """hello: what builds run. memory_bytes: resident memory of one process, beyond which it is replaced."""
        self._hello = hello
        self._seats = seats
        self._memory_bytes = memory_bytes
        self.admission = Admission(queue_limit)
        self._builds = MapBuilds(self._build, num_registrations)
        self._processes: list[WorkerProcess] = []
        self._queue: list[Work] = []
        self._numbers = itertools.count()
        self._supervisors: list[asyncio.Task[None]] = []
        self._draining = False
        self._was_ready = False
        self._problem = ""
        self._resident_bytes: dict[str, int] = {}
        self._index_loads: dict[str, int] = {}
        self._num_retries = 0

    async def start(self) -> None:
        """Begin to bring the workers up and return at once; `state` tells when they are."""
        self._supervisors = [asyncio.create_task(self._supervise(seat)) for seat in self._seats]
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
        num_workers = sum(process.num_workers for process in self._processes)
        waiting_for = None if num_workers else "workers" + (f" ({self._problem})" if self._problem else "")
        if self._draining:
            waiting_for = "its end: the service is shutting down"
        return PoolState(
            ready=waiting_for is None,
            waiting_for=waiting_for,
            num_workers=num_workers,
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
        with self.admission.admit(job.kind, remaining_s):
            async with _deadline(remaining_s):
                work = Work(next(self._numbers), "localize", job)
                for _ in range(_MAX_REBUILDS + 1):
                    reply = await self._reply_to(work)
                    if not reply.missing:
                        self.admission.note_duration(time.monotonic() - work.begun_s, job.kind)
                        return _outcome(reply)
                    await self._builds.rebuild(reply.missing)
                    work = work.again()
        raise NoWorkerError(f"Redis does not keep the index of {job.maps[0].id}; check its maxmemory")

    async def register(self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once) -> RegisterOutcome:
        """Build and store a map's index in a process of its own, after the registrations that came before it."""
        self._require_workers()
        return _outcome(await self._builds.register(job, begin))

    @property
    def _is_open(self) -> bool:
        """Tell whether queries are taken. While a worker is replaced they wait for the next one."""
        return self._was_ready and not self._draining and not self._problem

    def _require_workers(self) -> None:
        if not self._is_open:
            raise NoWorkerError(f"no worker can take this request: waiting for {self.state().waiting_for or 'workers'}")

    async def _reply_to(self, work: Work) -> WorkerReply[LocalizeOutcome]:
        heapq.heappush(self._queue, work)
        self._hand_out()
        reply = await work.future
        self._resident_bytes[reply.worker] = reply.resident_bytes
        for source, count in reply.index_loads.items():
            self._index_loads[source] = self._index_loads.get(source, 0) + count
        return reply

    def _hand_out(self) -> None:
        """Give waiting queries to processes with room."""
        while self._queue and (free := [each for each in self._processes if len(each.under_way) < each.capacity]):
            work = heapq.heappop(self._queue)
            if not work.future.done():
                max(free, key=lambda each: (work.maps <= each.known_maps, -len(each.under_way))).begin(work)

    def _note_change(self) -> None:
        num_workers = sum(process.num_workers for process in self._processes)
        if num_workers:
            self.admission.set_num_workers(num_workers)
            self._problem = ""
            if not self._was_ready:
                _log.info("the workers are ready", extra={"workers": num_workers})
            self._was_ready = True
        self._hand_out()

    def _note_loss(self, work: Work, how: str) -> None:
        self._resident_bytes.clear()
        if work.may_repeat(how):
            self._num_retries += 1
            lost = {"request_id": work.request.job.request_id, "attempt": work.num_attempts, "error": how}
            _log.warning("a worker was lost; the service repeats its query", extra=lost)
            heapq.heappush(self._queue, work)

    async def _supervise(self, seat: Seat) -> None:
        """Keep one process running: start another when it has ended, after a pause when it ended before it was ready."""
        pause_s = _FIRST_PAUSE_S
        while True:
            process = seat(self._note_change, self._note_loss)
            self._processes.append(process)
            try:
                how = await process.run()
            except OSError as error:  # no memory for another process
                how = str(error)
            finally:
                self._processes.remove(process)
            _log.warning("a worker process ended; the service starts another", extra={"error": process.problem or how})
            if process.was_ready:
                pause_s = _FIRST_PAUSE_S
                continue
            # One that was killed while it started is no sign that others will not start.
            if process.problem or pause_s > _FIRST_PAUSE_S:
                self._refuse_waiting(process.problem or how)
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _refuse_waiting(self, problem: str) -> None:
        """Let no query wait for workers that do not start."""
        if not any(process.num_workers for process in self._processes):
            self._problem = problem
            while self._queue:
                work = self._queue.pop()
                work.fail(f"no worker can take this request: {problem}")

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(_WATCH_PERIOD_S)
            for process in self._processes:
                process.end_if_astray(self._memory_bytes)

    async def _build(self, kind: Kind, job: Any) -> WorkerReply[Any]:
        """Run one build in a process that ends with it; see `panoloc.service.pool.map_builds.Build`."""
        return await run_build(self._hello, kind, job)


@contextlib.asynccontextmanager
async def _deadline(remaining_s: float) -> AsyncIterator[None]:
    """Raise DeadlineExceededError in the block when the time is over."""
    try:
        async with asyncio.timeout(max(0.0, remaining_s)):
            yield
    except TimeoutError as error:
        raise DeadlineExceededError(
            "no answer within timeout_s; allow more time, or narrow the search with hints"
        ) from error


def _outcome(reply: WorkerReply[Result]) -> Result:
    if reply.failure is not None:
        if reply.failure.traceback:
            _log.error("a worker failed unexpectedly", extra={"origin": reply.failure.traceback})
        raise error_of(reply.failure)
    assert reply.outcome is not None
    return reply.outcome
