"""uvicorn with the limits of this service, stopped in its order: refuse new work, finish what is under way, then
close."""

import asyncio
import logging
import math
import os
import signal
import socket
import ssl
import time
from types import FrameType
from typing import Any, Protocol

import uvicorn

_log = logging.getLogger(__name__)

# Longer than clients and proxies keep an idle connection (nginx and load balancers 60 s, httpx 5 s): they must be the
# ones that close first, because a request that meets a closing connection gets no answer.
_KEEP_ALIVE_S = 75
# Idle connections count. uvicorn answers 503 in plain text beyond it.
_MOST_CONNECTIONS = 1024
# Of a request line and headers that have not ended yet. uvicorn answers 400 beyond it.
_MOST_UNPARSED_BYTES = 64 * 1024
# From the start of a connection or request to the end of its headers; uvicorn has no such limit.
_HEAD_TIMEOUT_S = 10.0
# The kernel resets a connection whose client reads nothing, and acknowledges nothing, for so long.
_SEND_TIMEOUT_S = 30
# Finished answers leave within this time; a client that does not read does not delay the end.
_CLOSING_S = 5
# `timeout` and terminals signal a process, and then its process group: that is one request to end, not two.
_ONE_SIGNAL_S = 0.1
_TICKS_PER_S = 10  # of uvicorn's main loop


def server_config(app: Any, **settings: Any) -> uvicorn.Config:
    """Return uvicorn's configuration with our limits; settings: others of uvicorn."""
    limits: dict[str, Any] = {
        # httptools would collect headers without limit.
        "http": "h11",
        "h11_max_incomplete_event_size": _MOST_UNPARSED_BYTES,
        "limit_concurrency": _MOST_CONNECTIONS,
        "timeout_keep_alive": _KEEP_ALIVE_S,
        "timeout_graceful_shutdown": _CLOSING_S,
        "ws": "none",
    }
    return uvicorn.Config(app, log_config=None, access_log=False, server_header=False, **(limits | settings))


class Drainable(Protocol):
    """What may still have requests under way when the process is to end."""

    @property
    def num_under_way(self) -> int:
        """Return the number of requests it works on."""

    def begin_drain(self) -> None:
        """Refuse new requests from now on."""


class DrainingServer(uvicorn.Server):
    """Keeps its port open while it drains, so that readiness can answer 503. A second signal ends it at once.

    New connections get the certificate that is in the files of the configuration, which others renew every few weeks.
    """

    def __init__(self, config: uvicorn.Config, work: Drainable, drain_s: float) -> None:
        super().__init__(config)
        self._certified_by = self._certificate_files()
        self._work = work
        self._drain_s = drain_s
        self._deadline: float | None = None
        self._is_draining = False
        self._waiting_for_head: dict[Any, float] = {}
        self._signalled_at = -math.inf

    def end(self) -> None:
        """End now: what is under way has been refused or is of no use any more."""
        self.should_exit = True

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen. Accepted connections inherit the timeout of the listening sockets."""
        await super().startup(sockets)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            for listening in (each for server in self.servers for each in server.sockets):
                listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _SEND_TIMEOUT_S * 1000)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note a signal; `on_tick` acts on it."""
        since, self._signalled_at = time.monotonic() - self._signalled_at, time.monotonic()
        if since < _ONE_SIGNAL_S:
            return
        if self._deadline is None:
            self._deadline = time.monotonic() + self._drain_s
            return
        _log.warning("ending at once", extra={"signal": signal.Signals(sig).name})
        # Requests that uvicorn leaves unfinished are cancelled with the loop, which is expected.
        logging.getLogger("uvicorn.error").addFilter(_is_no_cancellation)
        self.should_exit = self.force_exit = True

    async def on_tick(self, counter: int) -> bool:
        """Tell whether the main loop ends: once nothing is under way any more, or the time to drain is over. Called
        every 0.1 s."""
        self._close_slow_heads(time.monotonic())
        if counter % _TICKS_PER_S == 0:
            self._renew_certificate()
        if self._deadline is not None and not self.should_exit:
            if not self._is_draining:
                self._is_draining = True
                _log.info("draining", extra={"under_way": self._work.num_under_way})
                self._work.begin_drain()
            self.should_exit = not self._work.num_under_way or time.monotonic() >= self._deadline
        return await super().on_tick(counter)

    def _renew_certificate(self) -> None:
        """Take the certificate from its files where these are others than before, and it fits its key: one may be written before the
        other."""
        certificate, key, files = self.config.ssl_certfile, self.config.ssl_keyfile, self._certificate_files()
        if self.config.ssl is None or certificate is None or files == self._certified_by:
            return
        self._certified_by = files
        try:
            # First into an empty one: a certificate that does not fit its key leaves a context without either.
            for context in (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), self.config.ssl):
                context.load_cert_chain(certificate, key, password="")
        except (OSError, ValueError) as error:
            _log.warning(
                "the certificate cannot be renewed", extra={"certificate": str(certificate), "error": str(error)}
            )
        else:
            _log.info("certificate renewed", extra={"certificate": str(certificate)})

    def _certificate_files(self) -> list[tuple[int, int]]:
        """Return what tells the files of the certificate and its key from those that replace them; nothing while one is missing."""
        try:
            found = [os.stat(path) for path in (self.config.ssl_certfile, self.config.ssl_keyfile) if path is not None]
        except OSError:
            return []
        return [(each.st_ino, each.st_mtime_ns) for each in found]

    def _close_slow_heads(self, now: float) -> None:
        connections: set[Any] = set(self.server_state.connections)
        # An idle connection has a timer, and one with a request under way an answer that is not complete.
        waiting = [
            each
            for each in connections
            if each.timeout_keep_alive_task is None and (each.cycle is None or each.cycle.response_complete)
        ]
        self._waiting_for_head = {each: self._waiting_for_head.get(each, now) for each in waiting}
        for each, since in self._waiting_for_head.items():
            if now - since > _HEAD_TIMEOUT_S:
                each.transport.close()


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """Tell whether a record is about something other than a cancelled task."""
    return not (record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError))
