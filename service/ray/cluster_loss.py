"""What happens when a cluster is lost: nobody waits for its answers any more.

One of our own that loses a process does not come back within one process: a second cluster starts beside what is left of the first,
and queries under way are never answered. The service ends. One that we joined is missed until it answers again.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import TypeVar

from service.errors import NoWorkerError
from service.ray.cluster import RayCluster

_log = logging.getLogger(__name__)
Result = TypeVar("Result")

_WATCH_PERIOD_S = 1.0
# A cluster of others is given up when it did not answer so many times, a second apart.
_SILENT_TIMES = 3
# What starting Ray takes on a small machine, and what joining takes where it runs again.
_START_S = 20
_JOIN_S = 10


class ClusterLoss:
    """Used from one event loop. reason: which process of our own ended; absence: why one that we joined is missed; None: all is well."""

    def __init__(self, cluster: RayCluster) -> None:
        self.reason: str | None = None
        self.absence: str | None = None
        self._cluster = cluster
        self._callbacks: list[Callable[[], None]] = []
        self._silence_callbacks: list[Callable[[], None]] = []
        self._limits: set[asyncio.Timeout] = set()

    def call(self, callback: Callable[[], None]) -> None:
        """Let `callback` be called in the event loop when the cluster is lost, after those that were named before."""
        self._callbacks.append(callback)

    def call_on_silence(self, callback: Callable[[], None]) -> None:
        """Let `callback` be called in the event loop each time that a cluster which we joined does not answer any more."""
        self._silence_callbacks.append(callback)

    async def watch(self) -> None:
        """Look for the loss until it comes, on the side, because whoever waits for an answer of Ray does not learn of it."""
        if self._cluster.is_ours:
            while not self.has_come():
                await asyncio.sleep(_WATCH_PERIOD_S)
        else:
            await self._watch_contact()

    def has_come(self) -> bool:
        """Tell whether a process is gone; the first time, say so and end what waits for an answer."""
        if self.reason is not None:
            return True
        self.reason = self._cluster.missing_process()
        if self.reason is None:
            return False
        _log.error(
            "the service ends: its workers are lost, and only a new process gets others",
            extra={"error": self.reason, "advice": "let a supervisor start it again; was the machine out of memory?"},
        )
        self._end_waits()
        for callback in self._callbacks:
            callback()
        return True

    def fall_silent(self, absence: str) -> None:
        """Miss a cluster that we joined and whose calls hang, and let who was named leave it."""
        _log.warning("the Ray cluster does not answer, joining it again as soon as it does", extra={"error": absence})
        self._cluster.patience.end()
        self.miss(absence)
        for callback in self._silence_callbacks:
            callback()

    def miss(self, absence: str) -> None:
        """End what waits for an answer of a cluster that we joined, and refuse what comes, until it is `found`."""
        if not self._cluster.is_ours and self.absence is None:
            self.absence = absence
            self._end_waits()

    def found(self) -> None:
        """Go on: the cluster that was missed is about to be joined again."""
        self.absence = None

    def require_none(self) -> None:
        """Raise NoWorkerError after the loss, and while a cluster is missed."""
        if self.reason is not None:
            raise NoWorkerError(f"the service ends, because {self.reason}; try again once it runs again", _START_S)
        if self.absence is not None:
            raise NoWorkerError(
                f"the workers are away: {self.absence}; they are looked for until they are back", _JOIN_S
            )

    async def wait(self, work: Awaitable[Result], timeout_s: float | None) -> Result:
        """Wait for an answer of Ray. Raises TimeoutError after `timeout_s`, and NoWorkerError as soon as the cluster is lost."""
        try:
            async with asyncio.timeout(timeout_s) as limit:
                self._limits.add(limit)
                try:
                    return await work
                finally:
                    self._limits.discard(limit)
        except TimeoutError:
            self.require_none()
            raise

    async def _watch_contact(self) -> None:
        num_silent = 0
        while True:
            await asyncio.sleep(_WATCH_PERIOD_S)
            silent = None if self.absence is not None else await asyncio.to_thread(self._cluster.silent)
            num_silent = 0 if silent is None else num_silent + 1
            if silent is not None and num_silent >= _SILENT_TIMES:
                self.fall_silent(silent)

    def _end_waits(self) -> None:
        for limit in self._limits:
            if not limit.expired():
                limit.reschedule(0.0)
