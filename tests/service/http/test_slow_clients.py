"""The rest of a refused request is discarded, but neither for long nor without end."""

import asyncio
from typing import Any

import pytest

from panoloc.service.http.guards import slow_clients
from panoloc.service.http.guards.slow_clients import SlowClients

Message = dict[str, Any]
MORE = {"type": "http.request", "body": b"x" * 1000, "more_body": True}
LAST = {"type": "http.request", "body": b"x", "more_body": False}
GONE = {"type": "http.disconnect"}
LARGE, SMALL = (b"content-length", b"20000000"), (b"content-length", b"2001")
UNKNOWN = (b"transfer-encoding", b"chunked")


class Caller:
    """Sends what it is told to, then falls silent, or goes on without end."""

    def __init__(self, *sends: Message, endlessly: bool = False, pause_s: float = 0.0) -> None:
        self._sends, self._endlessly, self._pause_s = list(sends), endlessly, pause_s
        self.num_taken = 0
        self.received: list[Message] = []

    async def receive(self) -> Message:
        await asyncio.sleep(self._pause_s)
        if self._endlessly:
            self.num_taken += 1
            return MORE
        if not self._sends:
            await asyncio.Event().wait()
        self.num_taken += 1
        return self._sends.pop(0)

    async def send(self, message: Message) -> None:
        self.received.append(message)

    @property
    def body(self) -> bytes:
        return b"".join(message.get("body", b"") for message in self.received)

    @property
    def is_answered(self) -> bool:
        return not self.received[-1].get("more_body", True)

    @property
    def closes(self) -> bool:
        return (b"connection", b"close") in self.received[0]["headers"]


def answer(caller: Caller, header: tuple[bytes, bytes] = LARGE, num_reads: int = 0) -> None:
    """Let an application read some messages of the caller, and refuse it."""

    async def app(scope: Any, receive: Any, send: Any) -> None:
        for _ in range(num_reads):
            await receive()
        await send({"type": "http.response.start", "status": 413, "headers": []})
        await send({"type": "http.response.body", "body": b"too large", "more_body": False})

    middleware: Any = SlowClients(app, lambda _: None)
    asyncio.run(middleware({"type": "http", "headers": [header]}, caller.receive, caller.send))


def test_no_more_than_so_many_bytes_are_discarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_clients, "_MOST_LINGER_BYTES", 10_000)
    caller = Caller(endlessly=True)
    answer(caller)
    assert caller.num_taken == 10
    assert (caller.body, caller.is_answered, caller.closes) == (b"too large", True, True)


@pytest.mark.parametrize("caller", [Caller(MORE), Caller(endlessly=True, pause_s=0.01)], ids=["silent", "drips"])
def test_a_caller_is_not_waited_for_longer_than_a_moment(caller: Caller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_clients, "_LINGER_S", 0.05)
    answer(caller)
    assert caller.num_taken < 20
    assert (caller.body, caller.is_answered) == (b"too large", True)


def test_the_answer_leaves_before_anything_is_discarded() -> None:
    class Asking(Caller):
        async def receive(self) -> Message:
            assert self.body == b"too large"
            return await super().receive()

    caller = Asking(MORE, LAST)
    answer(caller)
    assert caller.num_taken == 2
    assert caller.is_answered


@pytest.mark.parametrize("end", [LAST, GONE, {"type": "http.request"}])
def test_lingering_ends_with_what_the_caller_sends(end: Message) -> None:
    caller = Caller(MORE, MORE, end, MORE)
    answer(caller)
    assert caller.num_taken == 3


@pytest.mark.parametrize("header", [LARGE, UNKNOWN])
def test_the_connection_of_a_request_that_was_read_is_kept(header: tuple[bytes, bytes]) -> None:
    caller = Caller(MORE, LAST, MORE)
    answer(caller, header, num_reads=2)
    assert (caller.num_taken, caller.is_answered, caller.closes) == (2, True, False)


def test_the_connection_is_kept_where_a_small_rest_comes_and_closed_where_it_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slow_clients, "TIMEOUT_S", 0.05)
    for caller, comes in ((Caller(MORE, MORE, LAST), True), (Caller(MORE), False)):
        answer(caller, SMALL)
        # uvicorn closes the connection of an answer that does not end.
        assert (caller.body, caller.closes, caller.is_answered) == (b"too large", False, comes)
