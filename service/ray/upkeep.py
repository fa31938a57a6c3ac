"""Brings Ray and the workers up, looks after them, and begins again when they are lost. Ray is asked in a thread of its own."""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from service.errors import NoWorkerError
from service.ray.cluster import RayCluster
from service.ray.cluster_loss import ClusterLoss
from service.ray.own_node import RayStartError
from service.ray.patience import GivenUpError
from service.ray.queue.admission import Admission
from service.ray.serving import RayServing

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

_WATCH_PERIOD_S = 1.0
_TIDY_PERIOD_S = 60.0
_FOLLOW_PERIOD_S = 5.0
_RESTART_PAUSE_S = 5.0
_LEAVE_S = 10.0
# Ray Serve's controller is replaced within half of that on a busy machine.
_SILENCE_S = 60.0
_UNSTICK_S = 10.0


class Upkeep:
    """Used from one event loop.

    handle: calls the workers, None while there is no way to them. waiting_for: what is missing, None when all is well. num_running:
    workers that are up.
    """

    def __init__(self, cluster: RayCluster, serving: RayServing, admission: Admission, loss: ClusterLoss) -> None:
        self.handle: Any = None
        self.waiting_for: str | None = "the worker pool"
        self.num_running = 0
        self._cluster = cluster
        self._serving = serving
        self._admission = admission
        self._loss = loss
        self._thread = _ray_thread()
        self._is_doubtful = not cluster.is_ours
        self._tidied_s = time.monotonic()
        self._followed_s = time.monotonic()
        self._abandoning: asyncio.Future[None] | None = None
        loss.call_on_silence(self._abandon)

    async def run(self) -> None:
        """Go on until this is cancelled, or a cluster of our own is lost."""
        while True:
            try:
                if self._abandoning is not None:
                    await self._disconnect()
                if self.handle is None:
                    await self._bring_up()
                await self._look_after()
                await asyncio.sleep(_WATCH_PERIOD_S)
            except asyncio.CancelledError:
                raise
            except Exception as error:
                if self._loss.has_come():
                    return
                told, traced = {"error": str(error)}, not isinstance(error, (RayStartError, NoWorkerError))
                _log.warning("the worker pool is down, starting it again", extra=told, exc_info=traced)
                self._loss.miss(str(error))
                self.waiting_for = f"workers ({self._loss.absence or error})"
                self.handle, self.num_running = None, 0
                await self._disconnect()
                await asyncio.sleep(_RESTART_PAUSE_S)

    async def submit(self, *task: Any) -> Any:
        """Start a task of `service.ray.remote` and return its object reference."""
        return await self._in_ray_thread(self._serving.submit, *task)

    async def leave(self) -> None:
        """Take the workers away where nobody else uses them, and leave the cluster; for no longer than ten seconds."""
        if self._loss.reason is None:
            try:
                async with asyncio.timeout(_LEAVE_S):
                    if self.handle is not None:
                        await self._in_ray_thread(self._serving.retire)
                    await self._disconnect()
            except TimeoutError:
                _log.warning("Ray does not end, leaving it to the lifeline")
            except NoWorkerError as error:
                _log.warning("the cluster is away, its workers stay where they are", extra={"error": str(error)})
        self._thread.shutdown(wait=False)

    async def _bring_up(self) -> None:
        self.waiting_for = f"Ray ({self._loss.absence})" if self._loss.absence else "Ray"
        if self._is_doubtful:
            # To join a cluster that is away holds the interpreter for half a minute, in which liveness would be silent.
            await asyncio.to_thread(self._cluster.rehearse)
        self._is_doubtful = True
        self._loss.found()
        await self._in_ray_thread(self._cluster.connect)
        self._is_doubtful = False
        self.waiting_for = "workers"
        problems = await self._in_ray_thread(self._serving.unreachable)
        if problems:
            raise RuntimeError("; ".join(problems))
        while (deployed := await self._in_ray_thread(self._serving.deploy)) is None:
            self.waiting_for = "workers, which another front door brings up"
            await asyncio.sleep(_WATCH_PERIOD_S)
        self.handle, staffing = deployed
        self._admission.set_num_workers(staffing.num_workers)

    async def _look_after(self) -> None:
        try:
            async with asyncio.timeout(None if self._cluster.is_ours else _SILENCE_S) as limit:
                if time.monotonic() - self._followed_s > _FOLLOW_PERIOD_S:
                    self._followed_s = time.monotonic()
                    await self._in_ray_thread(self._serving.follow_machines)
                self.num_running = await self._in_ray_thread(self._serving.num_running)
                others = await self._in_ray_thread(self._serving.exchange_load, self._admission.num_admitted)
        except TimeoutError:
            if limit.expired():
                self._loss.fall_silent(f"Ray Serve has not answered for {_SILENCE_S:.0f} s")
            raise
        # The cluster may have gone away just after the last answer.
        self._loss.require_none()
        told = f" ({self._serving.told})" if self._serving.told else ""
        if self.num_running and self.waiting_for is not None:
            _log.info("the workers are ready", extra={"workers": self.num_running})
        self.waiting_for = None if self.num_running else f"workers{told}"
        if self.num_running:
            self._admission.set_num_workers(self.num_running)
        self._admission.set_others(others)
        if time.monotonic() - self._tidied_s > _TIDY_PERIOD_S:
            self._tidied_s = time.monotonic()
            await asyncio.to_thread(self._cluster.remove_logs_of_ended)

    def _abandon(self) -> None:
        """Leave a cluster that does not answer."""
        self.handle, self.num_running = None, 0
        self.waiting_for = f"Ray ({self._loss.absence})"
        if self._abandoning is None:
            self._abandoning = asyncio.ensure_future(self._leave_silent())

    async def _leave_silent(self) -> None:
        """Disconnect once Ray's thread is free, or in another one: some calls that hang end by that, and others never do."""
        loop = asyncio.get_running_loop()
        is_free = loop.run_in_executor(self._thread, lambda: None)
        if (await asyncio.wait({is_free}, timeout=_UNSTICK_S))[0]:
            await loop.run_in_executor(self._thread, self._cluster.disconnect)
            return
        await asyncio.to_thread(self._cluster.disconnect)
        if not (await asyncio.wait({is_free}, timeout=_UNSTICK_S))[0]:
            _log.error("a call of Ray does not end; its thread stays until the service is started again")
            self._thread.shutdown(wait=False, cancel_futures=True)
            self._thread = _ray_thread()

    async def _disconnect(self) -> None:
        self._is_doubtful = self._is_doubtful or not self._cluster.is_ours
        if self._abandoning is not None:
            await asyncio.gather(self._abandoning, return_exceptions=True)
            self._abandoning = None
            return
        with contextlib.suppress(Exception):
            await asyncio.get_running_loop().run_in_executor(self._thread, self._cluster.disconnect)

    async def _in_ray_thread(self, call: Callable[..., Result], *arguments: Any) -> Result:
        asked = asyncio.get_running_loop().run_in_executor(self._thread, self._asked, call, *arguments)
        return await self._loss.wait(asked, None)

    def _asked(self, call: Callable[..., Result], *arguments: Any) -> Result:
        try:
            return call(*arguments)
        except (SystemExit, GivenUpError) as error:  # the first one would end the service
            raise NoWorkerError(f"Ray does not answer: {error}") from error


def _ray_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="ray")
