"""Many callers from one event loop, as cheap as callers can be: what they take of the processors is missing to the service.

Threads with a library each take more of them than the refusals that they ask for, and what they measure is how long they wait for
each other.
"""

import asyncio
import json
import time
from urllib.parse import urlsplit

import httpx

from tests.campaign.clients import Answers
from tests.integration.small_room import small_room

_LIMIT_BYTES = 2**20


class Flood:
    """Sends one panorama again and again to one service."""

    def __init__(self, url: str, map_id: str, timeout_s: float = 300.0) -> None:
        place = urlsplit(url)
        self._place = place.hostname or "", place.port or 80
        self._patience_s = timeout_s + 30
        asked = httpx.Request(
            "POST",
            f"{url}/localize",
            files={"image": ("photo.jpg", small_room().panorama)},
            data={"map_id": map_id, "options": json.dumps({"timeout_s": timeout_s})},
        )
        body = asked.read()
        head = [f"POST /localize HTTP/1.1\r\nHost: {place.netloc}", *(f"{k}: {v}" for k, v in _described(asked))]
        self._request = "\r\n".join([*head, "", ""]).encode() + body

    def of_impatient(self, num_clients: int, seconds: float) -> Answers:
        """Let so many callers ask, each again as soon as it has an answer, whatever that is."""
        return asyncio.run(self._impatient(num_clients, seconds))

    def of_newcomers(self, per_s: float, seconds: float) -> Answers:
        """Let so many callers come each second, whatever happens to those before; each asks once, on a connection of its own."""
        return asyncio.run(self._newcomers(per_s, seconds))

    async def _impatient(self, num_clients: int, seconds: float) -> Answers:
        answers, end = Answers(), time.monotonic() + seconds

        async def ask() -> None:
            connection: Connection | None = None
            while time.monotonic() < end:
                began = time.monotonic()
                connection = connection or await self._connected()
                if await self._ask(connection, began, answers):
                    continue
                connection.close()
                connection = None
            if connection is not None:
                connection.close()

        await asyncio.gather(*(ask() for _ in range(num_clients)))
        return answers

    async def _newcomers(self, per_s: float, seconds: float) -> Answers:
        answers, began = Answers(), time.monotonic()

        async def ask_once(at: float) -> None:
            await asyncio.sleep(max(0.0, at - time.monotonic()))
            # From the moment at which it should have come: a generator that lags behind must not hide that.
            connection = await self._connected()
            await self._ask(connection, at, answers)
            connection.close()

        await asyncio.gather(*(ask_once(began + number / per_s) for number in range(int(per_s * seconds))))
        return answers

    async def _connected(self) -> "Connection":
        return Connection(*await asyncio.open_connection(*self._place, limit=_LIMIT_BYTES))

    async def _ask(self, connection: "Connection", began: float, answers: Answers) -> bool:
        """Ask once; return whether the connection can be used again."""
        status, document, stays = 0, b"", False
        try:
            async with asyncio.timeout(self._patience_s):
                status, document, stays = await connection.ask(self._request)
        except (OSError, EOFError, TimeoutError):
            pass  # counted as no answer
        ended = time.monotonic()
        answers.at.append(ended)
        answers.status.append(status)
        answers.seconds.append(ended - began)
        answers.wrong += status == 200 and not small_room().error_of(json.loads(document)).within(0.05, 5)
        return stays


class Connection:
    """One of HTTP/1.1 that reads answers with a length."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    async def ask(self, request: bytes) -> tuple[int, bytes, bool]:
        """Return status and body, and whether the connection stays. Raises OSError, EOFError."""
        self._writer.write(request)
        head = (await self._reader.readuntil(b"\r\n\r\n")).lower()
        lines = dict(line.split(b": ", 1) for line in head.split(b"\r\n")[1:] if line)
        body = await self._reader.readexactly(int(lines[b"content-length"]))
        # All of the request is out before the next one: an answer may come before that.
        await self._writer.drain()
        return int(head.split()[1]), body, lines.get(b"connection") != b"close"

    def close(self) -> None:
        """Close it."""
        self._writer.close()


def _described(request: httpx.Request) -> list[tuple[str, str]]:
    return [(name, value) for name, value in request.headers.items() if name.startswith("content-")]
