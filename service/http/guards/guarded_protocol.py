"""uvicorn's protocol with limits: connections, the head of a request, and clients that neither send nor read.

What comes before the first byte of a body, and what is left of an answer that nobody reads, no ASGI application sees.
"""

import asyncio
import functools
from typing import Any

import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.http.guards.bare_answers import bare_refusal
from service.limits.connection_limits import ConnectionCount, Refusal

# Longer than clients and proxies keep an idle connection (nginx and load balancers 60 s, httpx 5 s): whoever closes first must be
# they, for a request that meets a closing connection gets no answer.
_KEEP_ALIVE_S = 75


class GuardedProtocol(HttpToolsProtocol):
    """One connection."""

    def __init__(self, *given: Any, count: ConnectionCount, **named: Any) -> None:
        super().__init__(*given, **named)
        self._count = count
        self._limits = count.limits
        self._address: str | None = None
        self._refused = False
        self._in_head = False
        self._began_here = False
        self._num_head_bytes = 0
        self._head_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None
        self._in_body = False
        self._num_unread_bytes = 0
        self._unread_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or say why not."""
        super().connection_made(transport)
        address = self.client[0] if self.client else ""
        self._count.make_room(address)
        reason = self._count.why_not(address)
        if reason is not None:
            self._refuse(503, *reason)
            return
        self._address = address
        self._count.add(address)
        self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._leave_count()
        self._end_head()
        self._cancel_write_timer()
        self._end_unread()
        super().connection_lost(exc)

    def give_way(self) -> None:
        """End an idle connection, for one that is new."""
        self._leave_count()
        self.transport.close()

    def data_received(self, data: bytes) -> None:
        """Take bytes, unless the head of a request has become too long."""
        self._count.works(self)
        if self._refused:
            return
        self._began_here = False
        super().data_received(data)
        if self._in_head and not self._began_here and not self._refused:
            # What the parser holds back of a header that has not ended; it would put it together piece by piece.
            self._num_head_bytes += len(data)
            self._check_head()

    def on_message_begin(self) -> None:
        """Begin a request."""
        self._unset_keepalive_if_required()
        super().on_message_begin()
        self._in_head = self._began_here = True
        self._num_head_bytes = 0
        self._expect_head()

    def on_url(self, url: bytes) -> None:
        """Take a part of the path."""
        self._num_head_bytes += len(url)
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take one header."""
        self._num_head_bytes += len(name) + len(value)
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Begin to answer."""
        self._end_head()
        self._in_head = False
        self._check_head()
        self._in_body = True
        if not self._refused:
            super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Take a part of the body; the parser throws away what comes after the answer."""
        self._num_unread_bytes += len(body)
        if not self._refused:
            super().on_body(body)

    def on_message_complete(self) -> None:
        """End a request."""
        self._in_body = False
        self._end_unread()
        if self._refused:
            return
        super().on_message_complete()
        if self.cycle.response_complete and not self.transport.is_closing():
            # Answered before it was over: its last bytes have stopped the clock of idle connections, which goes on only now.
            self.timeout_keep_alive_task = self.loop.call_later(
                self.timeout_keep_alive, self.timeout_keep_alive_handler
            )
        self._note_rest()

    def on_response_complete(self) -> None:
        """End an answer; what still comes of a body that nobody has read has to come as fast as if it were read."""
        super().on_response_complete()
        if self._in_body and self.cycle.response_complete and not self.transport.is_closing():
            self._watch_unread()
        self._note_rest()

    def send_400_response(self, msg: str) -> None:
        """Refuse what the parser cannot read."""
        if not self._refused:
            self._refuse(
                400,
                "no-http",
                "expected a request of HTTP/1.1, got one that cannot be read; look at its method, path, headers and lengths, and "
                "put a proxy before the service where clients speak TLS (https://)",
            )

    def pause_writing(self) -> None:
        """Wait for a client that does not read, but not for ever."""
        super().pause_writing()
        self._watch_reader(self.transport.get_write_buffer_size())

    def resume_writing(self) -> None:
        """Go on writing."""
        super().resume_writing()
        self._cancel_write_timer()

    def timeout_keep_alive_handler(self) -> None:
        """Close an idle connection, also where the last answer has not been read."""
        super().timeout_keep_alive_handler()
        self._watch_reader(self.transport.get_write_buffer_size())

    def _note_rest(self) -> None:
        if self._address is not None and self._is_idle():
            self._count.rests(self, self._address)

    def _is_idle(self) -> bool:
        is_read = self.transport.get_write_buffer_size() == 0
        return is_read and not self._in_body and self.timeout_keep_alive_task is not None

    def _leave_count(self) -> None:
        self._count.works(self)
        if self._address is not None:
            self._count.remove(self._address)
            self._address = None

    def _check_head(self) -> None:
        if self._num_head_bytes > self._limits.header_bytes and not self._refused:
            self._refuse(
                431,
                "header-bytes",
                f"expected at most {self._limits.header_bytes:,} bytes of path and headers (PANOLOC_MAX_HEADER_BYTES), got more; send "
                "what is large in the body",
            )

    def _expect_head(self) -> None:
        if self._head_timer is None:
            self._head_timer = self.loop.call_later(self._limits.header_timeout_s, self._give_head_up)

    def _end_head(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _give_head_up(self) -> None:
        self._head_timer = None
        self._refuse(
            408,
            "slow-header",
            f"expected the head of a request within {self._limits.header_timeout_s:g} s (PANOLOC_HEADER_TIMEOUT_S), got less; send it "
            "at once",
        )

    def _watch_reader(self, num_waiting: int) -> None:
        """Look later whether the client has read what it has to in that time, and let it go when not."""
        self._cancel_write_timer()
        if num_waiting:
            self._write_timer = self.loop.call_later(self._limits.transfer_timeout_s, self._look_at_reader, num_waiting)

    def _look_at_reader(self, num_before: int) -> None:
        num_waiting = self.transport.get_write_buffer_size()
        if num_before - num_waiting < self._limits.bytes_per_s * self._limits.transfer_timeout_s and num_waiting:
            self._count.note_refusal("slow-reader")
            self.transport.abort()
        else:
            self._watch_reader(num_waiting)

    def _watch_unread(self) -> None:
        self._num_unread_bytes = 0
        self._unread_timer = self.loop.call_later(self._limits.transfer_timeout_s, self._look_at_unread)

    def _look_at_unread(self) -> None:
        if self._num_unread_bytes < self._limits.bytes_per_s * self._limits.transfer_timeout_s:
            self._count.note_refusal("slow-body")
            self.transport.close()
        else:
            self._watch_unread()

    def _end_unread(self) -> None:
        if self._unread_timer is not None:
            self._unread_timer.cancel()
            self._unread_timer = None

    def _cancel_write_timer(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None

    def _refuse(self, status: int, refusal: Refusal, detail: str) -> None:
        self._refused = True
        self._end_head()
        self._count.note_refusal(refusal)
        if not self.transport.is_closing():
            self.transport.write(bare_refusal(status, detail))
            self.transport.close()
            self._watch_reader(self.transport.get_write_buffer_size())


def guarded_protocol(count: ConnectionCount) -> Any:
    """Return what `uvicorn.Config` takes as `http`."""
    return functools.partial(GuardedProtocol, count=count)


def guarded_config(app: Any, count: ConnectionCount, **settings: Any) -> uvicorn.Config:
    """Return the configuration of a server that keeps the limits; settings: others of uvicorn."""
    settings.setdefault("timeout_keep_alive", _KEEP_ALIVE_S)
    # No path of ours is a WebSocket, whose protocol would take a connection out of the count.
    return uvicorn.Config(app, http=guarded_protocol(count), ws="none", log_config=None, access_log=False, **settings)
