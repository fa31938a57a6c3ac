"""uvicorn, stopped in our order: say that nothing more is taken, finish what is under way, then close."""

import asyncio
import contextlib
import logging
import math
import signal
import time
from collections.abc import Iterator
from typing import Protocol

import uvicorn

_log = logging.getLogger(__name__)

_POLL_S = 0.05
# Answers that are ready leave within this time; a client that does not read does not hold up the end.
_CLOSING_S = 5
# `timeout` and terminals signal a process, and then the group that it is in: one wish, not two.
_ONE_SIGNAL_S = 0.1


class Drainable(Protocol):
    """What may still be at work when the end is near."""

    @property
    def num_under_way(self) -> int:
        """Return how many requests it works on."""

    def begin_drain(self) -> None:
        """Refuse new requests from now on."""


class DrainingServer(uvicorn.Server):
    """Keeps its port open while it drains, so that readiness can say 503; a second signal ends it at once."""

    def __init__(self, config: uvicorn.Config, pool: Drainable, drain_s: float) -> None:
        config.timeout_graceful_shutdown = _CLOSING_S
        super().__init__(config)
        self._pool = pool
        self._drain_s = drain_s
        self._draining: asyncio.Task[None] | None = None
        self._signalled_at = -math.inf

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take SIGTERM and SIGINT for as long as the server runs."""
        loop = asyncio.get_running_loop()
        for each in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(each, self._on_signal, each)
        try:
            yield
        finally:
            for each in (signal.SIGTERM, signal.SIGINT):
                loop.remove_signal_handler(each)

    def end(self) -> None:
        """End now: what is under way has been refused or is of no use any more."""
        self.should_exit = True

    def _on_signal(self, received: signal.Signals) -> None:
        since, self._signalled_at = time.monotonic() - self._signalled_at, time.monotonic()
        if since < _ONE_SIGNAL_S:
            return
        if self._draining is not None:
            _log.warning("ending at once", extra={"signal": received.name})
            # What uvicorn then leaves unfinished ends with the loop, which is no news.
            logging.getLogger("uvicorn.error").addFilter(_is_no_cancellation)
            self._draining.cancel()
            self.should_exit = self.force_exit = True
            return
        _log.info("draining", extra={"signal": received.name, "under_way": self._pool.num_under_way})
        self._pool.begin_drain()
        self._draining = asyncio.get_running_loop().create_task(self._drain())

    async def _drain(self) -> None:
        deadline = time.monotonic() + self._drain_s
        while self._pool.num_under_way and time.monotonic() < deadline:
            await asyncio.sleep(_POLL_S)
        self.should_exit = True


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """Tell whether a record is of something else than a task that the end cut off."""
    return not (record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError))
