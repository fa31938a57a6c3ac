"""What happens when a cluster of our own loses a process: nobody waits for its answers any more.

Ray does not come back from this within one process: a second cluster starts beside what is left of the first, and queries
under way are never answered.
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
# What starting Ray takes on a small machine.
_START_S = 20


class ClusterLoss:
    """Used from one event loop. reason: which process ended; None while all is well."""

    def __init__(self, cluster: RayCluster) -> None:
        self.reason: str | None = None
        self._cluster = cluster
        self._callbacks: list[Callable[[], None]] = []
        self._limits: set[asyncio.Timeout] = set()

    def call(self, callback: Callable[[], None]) -> None:
        """Let `callback` be called in the event loop when the cluster is lost, after those that were named before."""
        self._callbacks.append(callback)

    async def watch(self) -> None:
        """Look for the loss until it comes, on the side, because whoever waits for an answer of Ray does not learn of it."""
        while not self.has_come():
            await asyncio.sleep(_WATCH_PERIOD_S)

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
        for limit in self._limits:
            if not limit.expired():
                limit.reschedule(0.0)
        for callback in self._callbacks:
            callback()
        return True

    def require_none(self) -> None:
        """Raise NoWorkerError after the loss."""
        if self.reason is not None:
            raise NoWorkerError(f"the service ends, because {self.reason}; try again once it runs again", _START_S)

    async def wait(self, work: Awaitable[Result], timeout_s: float) -> Result:
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
