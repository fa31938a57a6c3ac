"""The worker pool on Ray Serve, called through its handle from our own process.

Serve does not repeat a request whose replica died; this pool does, because a localization changes nothing.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from core.errors import DeadlineExceededError
from service.errors import NoWorkerError
from service.jobs import LocalizeJob, LocalizeOutcome, PoolState, RegisterJob, RegisterOutcome, at_once
from service.ray.cluster import RayCluster
from service.ray.cluster_loss import ClusterLoss
from service.ray.map_builds import MapBuilds
from service.ray.queue.admission import Admission
from service.ray.serving import RayServing
from service.ray.upkeep import Upkeep
from service.worker.reply import WorkerReply, error_of

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

# Which of the queries under way ended their worker nobody knows. One that lost several is asked again alone, and nothing else is asked
# meanwhile: so it comes first where workers keep dying, and takes no others along where it is what ends them.
_ATTEMPTS_TOGETHER = 3
# Others wait for it no longer than a worker takes to come back and to answer a usual query; the slow ones hold up nobody.
_LONGEST_ALONE_S = 10.0
_ATTEMPTS_ALONE = 3
_MAX_REBUILDS = 2
_END_BUILDS_S = 5.0


class RayPool:
    """Implements `service.jobs.WorkerPool`. Used from one event loop."""

    def __init__(
        self, cluster: RayCluster, serving: RayServing, admission: Admission, num_registrations: int = 1
    ) -> None:
        """num_registrations: that run at the same time; each takes the memory of a whole scan."""
        self._is_ours = cluster.is_ours
        self._admission = admission
        self._loss = ClusterLoss(cluster)
        self._upkeep = Upkeep(cluster, serving, admission, self._loss)
        self._builds = MapBuilds(self._upkeep.submit, num_registrations)
        self._ending_builds: set[asyncio.Task[None]] = set()
        self._draining = False
        self._watch: asyncio.Future[tuple[None, None]] | None = None
        self._workers: dict[str, WorkerReply[Any]] = {}
        self._index_loads: dict[str, int] = {}
        self._num_retries = 0
        self._asked_alone = asyncio.Lock()
        self._loss.call(self.begin_drain)
        self._loss.call_on_silence(self._end_builds)

    @property
    def loss(self) -> str | None:
        """Return which process of a cluster of our own ended; the service cannot serve any more then. None: all is well."""
        return self._loss.reason

    def call_on_loss(self, callback: Callable[[], None]) -> None:
        """Let `callback` be called in the event loop when the cluster is lost; callers are refused by then."""
        self._loss.call(callback)

    async def start(self) -> None:
        """Begin to bring the workers up and return at once; `state` tells when they are."""
        self._watch = asyncio.gather(self._upkeep.run(), self._loss.watch())

    async def stop(self, drain_s: float) -> None:
        """Take nothing more, wait up to `drain_s` for what is under way, then end the workers.

        What is left of a lost cluster is left to the lifeline: Ray's calls would wait for the dead.
        """
        self.begin_drain()
        deadline = time.monotonic() + drain_s
        while self.num_under_way and time.monotonic() < deadline:
            await asyncio.sleep(0.05)
        if self._watch is not None:
            self._watch.cancel()
            await asyncio.gather(self._watch, return_exceptions=True)
        if self._loss.reason is None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_END_BUILDS_S):
                    await self._builds.cancel()
        await self._upkeep.leave()

    @property
    def num_under_way(self) -> int:
        """Return how many queries wait or run."""
        return self._admission.num_admitted

    def begin_drain(self) -> None:
        """Refuse new requests from now on; those under way go on."""
        self._draining = True

    def state(self) -> PoolState:
        """Return what readiness and metrics tell about the pool."""
        waiting_for = "its end: the service is shutting down" if self._draining else self._upkeep.waiting_for
        return PoolState(
            ready=waiting_for is None,
            waiting_for=waiting_for,
            num_workers=self._upkeep.num_running,
            queue_depth=self._admission.queue_depth,
            resident_bytes=sum(reply.resident_bytes for reply in self._workers.values()),
            index_loads=dict(self._index_loads),
            num_retries=self._num_retries,
        )

    def require_place(self, longest_s: float) -> None:
        """Raise QueueFullError where a query would be refused whatever it asks; see `WorkerPool.require_place`."""
        # What else is amiss has another status, which `localize` says.
        if not self._draining and self._upkeep.handle is not None:
            self._admission.require_place(longest_s)

    async def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        """Answer one query on some worker; see `WorkerPool.localize` for the errors."""
        self._require_workers()
        with self._admission.admit(job.kind, job.deadline_unix_s - time.time()):
            number = self._admission.turns.number()
            for _ in range(_MAX_REBUILDS + 1):
                reply = await self._on_some_worker(job, number)
                if not reply.missing:
                    return self._outcome(reply)
                await self._before_deadline(self._builds.rebuild(reply.missing), job)
        raise NoWorkerError(f"the index of {job.maps[0].id} does not stay in Redis; is its maxmemory too small?")

    async def register(self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once) -> RegisterOutcome:
        """Build and store a map's index in a process of its own, after the registrations that came before it."""
        # Also because Ray starts a cluster by itself when it is given a task before there is one.
        self._require_workers()
        registering = self._builds.register(job, begin)
        # Whoever loses a cluster of his own ends, and takes the attempt back.
        return self._outcome(await (registering if self._is_ours else self._loss.wait(registering, None)))

    def _require_workers(self) -> Any:
        self._loss.require_none()
        if self._draining or self._upkeep.handle is None:
            raise NoWorkerError(f"no worker can take this: waiting for {self.state().waiting_for}")
        return self._upkeep.handle

    async def _on_some_worker(self, job: LocalizeJob, number: int) -> WorkerReply[LocalizeOutcome]:
        turns = self._admission.turns
        await self._before_deadline(turns.take(number), job)
        try:
            for attempt in range(1, _ATTEMPTS_TOGETHER + 1):
                await self._before_deadline(self._nothing_asked_alone(), job)
                if (reply := await self._asked(job, attempt)) is not None:
                    return reply
        finally:
            turns.give_back()
        await self._before_deadline(self._asked_alone.acquire(), job)
        try:
            for attempt in range(_ATTEMPTS_TOGETHER + 1, _ATTEMPTS_TOGETHER + _ATTEMPTS_ALONE + 1):
                if (reply := await self._asked(job, attempt)) is not None:
                    return reply
        finally:
            self._asked_alone.release()
        raise NoWorkerError(f"{attempt} workers in a row were lost while they computed this answer")

    async def _nothing_asked_alone(self) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_ALONE_S), self._asked_alone:
                pass

    async def _asked(self, job: LocalizeJob, attempt: int) -> WorkerReply[LocalizeOutcome] | None:
        """Return the answer of some worker, None where it was lost meanwhile."""
        from ray.exceptions import RayError, RayTaskError
        from ray.serve.exceptions import RayServeException

        handle = self._upkeep.handle or self._require_workers()
        response = handle.options(multiplexed_model_id=_residency_key(job)).localize.remote(job)
        try:
            reply: WorkerReply[LocalizeOutcome] = await self._before_deadline(_result_of(response), job)
        except RayTaskError:
            raise  # a fault in our own code, which no other worker would be spared
        except (RayError, RayServeException) as error:
            self._num_retries += 1
            self._workers.clear()
            lost = {"request_id": job.request_id, "attempt": attempt, "error": type(error).__name__}
            _log.warning("a worker was lost", extra=lost)
            return None
        except BaseException:
            if self._loss.absence is None:
                with contextlib.suppress(Exception):
                    response.cancel()
            raise
        self._note(reply, job)
        return reply

    async def _before_deadline(self, work: Any, job: LocalizeJob) -> Any:
        try:
            return await self._loss.wait(work, max(0.0, job.deadline_unix_s - time.time()))
        except TimeoutError as error:
            raise DeadlineExceededError(
                "no answer within timeout_s; allow more time, or narrow the search with hints"
            ) from error

    def _end_builds(self) -> None:
        """Let nobody wait for builds whose cluster is away; they are asked for again."""
        ending = asyncio.ensure_future(self._builds.cancel())
        self._ending_builds.add(ending)
        ending.add_done_callback(self._ending_builds.discard)

    def _outcome(self, reply: WorkerReply[Result]) -> Result:
        if reply.failure is not None:
            if reply.failure.traceback:
                _log.error("a worker met a fault of its own", extra={"origin": reply.failure.traceback})
            raise error_of(reply.failure)
        assert reply.outcome is not None
        return reply.outcome

    def _note(self, reply: WorkerReply[Any], job: LocalizeJob) -> None:
        self._workers[reply.worker] = reply
        for source, count in reply.index_loads.items():
            self._index_loads[source] = self._index_loads.get(source, 0) + count
        if not reply.missing:
            self._admission.note_duration(reply.duration_s, job.kind)


async def _result_of(response: Any) -> Any:
    """Wait for a Serve response; it is awaitable, but `asyncio.timeout` needs a coroutine."""
    return await response


def _residency_key(job: LocalizeJob) -> str:
    """Name what has to be resident for `job`, so that the router sends it where that already is."""
    return ",".join(f"{map_ref.id}:{map_ref.revision}" for map_ref in job.maps)
