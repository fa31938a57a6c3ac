"""What a refused caller still sends is thrown away, but neither for long nor without end."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from service.http.lingering import LingeringClose

Message = dict[str, Any]
CLOSING, STAYING = [(b"connection", b"close")], [(b"content-type", b"text/plain")]
START = "http.response.start"
MORE = {"type": "http.request", "body": b"x" * 1000, "more_body": True}
LAST = {"type": "http.request", "body": b"x", "more_body": False}


class Caller:
    """Sends what it is told to, then falls silent, and notes what it is answered."""

    def __init__(self, *sends: Message, endlessly: bool = False) -> None:
        self._sends = list(sends)
        self._endlessly = endlessly
        self.num_taken = 0
        self.heard: list[Message] = []

    async def receive(self) -> Message:
        self.num_taken += 1
        assert self.num_taken < 1000, "nobody stops reading"
        if self._endlessly:
            return MORE
        if not self._sends:
            await asyncio.Event().wait()
        return self._sends.pop(0)

    async def send(self, message: Message) -> None:
        self.heard.append(message)


def answer(
    caller: Caller, headers: Any = CLOSING, reads: int = 0, longest_s: float = 60.0, most_bytes: int = 10_000
) -> None:
    """Let an application read `reads` messages of the caller, refuse it, and linger."""

    async def app(scope: Message, receive: Callable[[], Awaitable[Message]], send: Callable[[Message], Any]) -> None:
        for _ in range(reads):
            await receive()
        await send({"type": START, "status": 413, "headers": headers})
        await send({"type": "http.response.body", "body": b"too ", "more_body": True})
        await send({"type": "http.response.body", "body": b"large", "more_body": False})

    lingering: Any = LingeringClose(app, longest_s, most_bytes)  # type: ignore[arg-type]
    asyncio.run(lingering({"type": "http"}, caller.receive, caller.send))


def body(caller: Caller) -> list[tuple[bytes, bool]]:
    assert caller.heard[0]["type"] == START
    return [(message["body"], message.get("more_body", False)) for message in caller.heard[1:]]


LINGERED = [(b"too ", True), (b"large", True), (b"", False)]
AT_ONCE = [(b"too ", True), (b"large", False)]


def test_no_more_than_so_many_bytes_are_thrown_away() -> None:
    caller = Caller(endlessly=True)
    answer(caller, most_bytes=10_000)
    assert caller.num_taken == 10
    assert body(caller) == LINGERED


def test_a_caller_who_falls_silent_is_not_waited_for() -> None:
    caller, began = Caller(MORE), time.monotonic()
    answer(caller, longest_s=0.05)
    assert 0.04 < time.monotonic() - began < 5
    assert caller.num_taken == 2
    assert body(caller) == LINGERED


def test_a_caller_who_dribbles_is_not_waited_for_longer_than_one_who_is_silent() -> None:
    class Dribbling(Caller):
        async def receive(self) -> Message:
            await asyncio.sleep(0.03)
            return await super().receive()

    caller, began = Dribbling(endlessly=True), time.monotonic()
    answer(caller, longest_s=0.1, most_bytes=10**9)
    assert time.monotonic() - began < 2
    assert body(caller) == LINGERED


def test_the_answer_is_out_before_anything_is_thrown_away() -> None:
    class Asking(Caller):
        async def receive(self) -> Message:
            assert [message.get("body") for message in self.heard] == [None, b"too ", b"large"]
            return await super().receive()

    caller = Asking(MORE, LAST)
    answer(caller)
    assert caller.num_taken == 2
    assert body(caller) == LINGERED


@pytest.mark.parametrize("end", [LAST, {"type": "http.disconnect"}, {"type": "http.request"}])
def test_lingering_ends_with_what_the_caller_sends(end: Message) -> None:
    caller = Caller(MORE, MORE, end)
    answer(caller)
    assert caller.num_taken == 3


@pytest.mark.parametrize("end", [LAST, {"type": "http.disconnect"}, {"type": "http.request"}])
def test_whoever_has_been_heard_out_is_answered_at_once(end: Message) -> None:
    caller = Caller(MORE, end)
    answer(caller, reads=2)
    assert caller.num_taken == 2
    assert body(caller) == AT_ONCE


def test_a_connection_that_stays_open_is_none_of_its_business() -> None:
    caller = Caller(MORE, MORE)
    answer(caller, STAYING)
    assert caller.num_taken == 0
    assert body(caller) == AT_ONCE


def test_what_is_no_request_passes() -> None:
    seen: list[Any] = []

    async def app(*arguments: Any) -> None:
        seen.append(arguments)

    async def receive() -> Message:
        return {}

    async def send(_: Any) -> None:
        pass

    asyncio.run(LingeringClose(app)({"type": "lifespan"}, receive, send))
    assert seen == [({"type": "lifespan"}, receive, send)]
