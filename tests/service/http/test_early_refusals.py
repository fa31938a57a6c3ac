"""Queries are refused by their head while the queue is full, and their callers can ask again on the same connection."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from panoloc.service.errors import QueueFullError
from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.http.guards import slow_clients
from panoloc.service.http.guards.early_refusals import RefusalPace
from panoloc.service.keys.caller import Scope
from panoloc.service.keys.key_file import KeyFile
from tests.service.http.fake_pool import FakePool
from tests.service.http.running_service import RunningService, Serve, listening

pytestmark = pytest.mark.anyio
FULL = QueueFullError("4 requests are waiting, which is the limit; try again in 7 s", 7)


class Connection:
    """Sends bytes, and reads one answer after the other."""

    def __init__(self, url: str) -> None:
        host, port = url.removeprefix("http://").split(":")
        self.socket = socket.create_connection((host, int(port)), timeout=30)
        self._data = b""

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def answer(self) -> tuple[int, dict[str, str]]:
        while b"\r\n\r\n" not in self._data:
            self._read()
        head, _, self._data = self._data.partition(b"\r\n\r\n")
        status, *lines = head.decode().split("\r\n")
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
        while len(self._data) < int(headers["content-length"]):
            self._read()
        self._data = self._data[int(headers["content-length"]) :]
        return int(status.split()[1]), headers

    def is_closed(self) -> bool:
        """Tell whether nothing more comes, waiting for it."""
        try:
            return not self._data and self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def _read(self) -> None:
        data = self.socket.recv(65536)
        assert data, "closed in the middle of an answer"
        self._data += data


@contextmanager
def full(
    monkeypatch: pytest.MonkeyPatch, folder: Path, redis: EmbeddedRedis, **settings: Any
) -> Iterator[tuple[str, Connection]]:
    """Serve an application whose queue is full."""

    def refuse(pool: FakePool, longest_s: float) -> None:
        raise FULL

    monkeypatch.setattr(FakePool, "require_place", refuse)
    with listening(folder, redis.url, **settings) as url:
        connection = Connection(url)
        with connection.socket:
            yield url, connection


def head(length: str, path: str = "/localize") -> bytes:
    kind = "Content-Type: multipart/form-data; boundary=b"
    return f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{kind}\r\n{length}\r\n\r\n".encode()


def counted(url: str, name: str) -> float:
    lines = httpx.get(f"{url}/metrics").text.splitlines()
    return float(next(line for line in lines if line.startswith(name)).rpartition(" ")[2])


@pytest.mark.parametrize("path", ["/localize", "/geopose", "/map_1a/localize/image"])
def test_queries_are_refused_before_a_byte_of_their_body(
    tmp_path: Path, redis_server: EmbeddedRedis, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    with full(monkeypatch, tmp_path, redis_server) as (url, connection):
        connection.send(head("Content-Length: 300000", path))
        status, headers = connection.answer()
        assert (status, headers["retry-after"], headers["content-type"]) == (429, "7", "application/problem+json")
        assert headers["x-request-id"].startswith("req_")
        assert counted(url, 'panoloc_refusals_total{limit="queue"}') == 1
        route = path.replace("map_1a", "{map_id:map_id}")
        assert counted(url, f'panoloc_http_requests_total{{method="POST",route="{route}",status="429"}}') == 1


def test_a_caller_who_sends_the_rest_asks_again_on_the_same_connection(
    tmp_path: Path, redis_server: EmbeddedRedis, monkeypatch: pytest.MonkeyPatch
) -> None:
    with full(monkeypatch, tmp_path, redis_server) as (_, connection):
        for _ in range(3):
            connection.send(head("Content-Length: 300000"))
            assert connection.answer()[0] == 429
            connection.send(b"x" * 300_000)
        connection.send(b"GET /health/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert connection.answer()[0] == 200


@pytest.mark.parametrize("length", ["Content-Length: 2000000", "Transfer-Encoding: chunked"])
def test_the_connection_is_closed_before_a_body_that_is_large_or_does_not_say(
    tmp_path: Path, redis_server: EmbeddedRedis, monkeypatch: pytest.MonkeyPatch, length: str
) -> None:
    monkeypatch.setattr(slow_clients, "_LINGER_S", 0.05)
    with full(monkeypatch, tmp_path, redis_server) as (_, connection):
        connection.send(head(length))
        status, headers = connection.answer()
        assert (status, headers["connection"]) == (429, "close")
        assert connection.is_closed()


async def test_who_may_not_ask_is_told_so_first(tmp_path: Path, serve: Serve) -> None:
    scopes: list[Scope] = ["read", "localize"]
    keys = {scope: KeyFile(tmp_path).make(scope, [scope])[1] for scope in scopes}
    async with serve() as running:
        running.pool.full = FULL
        statuses = []
        for key in (None, keys["read"], keys["localize"]):
            headers = {} if key is None else {"X-API-Key": key}
            statuses.append(await running.status("POST", "/localize", headers=headers))
    assert statuses == [401, 403, 429]


async def test_pages_of_other_sites_are_told_so_first(serve: Serve) -> None:
    async with serve() as running:
        running.pool.full = FULL
        reply = await running.client.post("/localize", headers={"Origin": "http://elsewhere.example"})
    assert reply.status_code == 403


async def test_a_place_and_other_paths_leave_everything_as_it_is(running: RunningService) -> None:
    map_id = await running.ready_map()
    assert (await running.localize(map_id)).status_code == 200
    running.pool.full = FULL
    assert (await running.localize(map_id)).status_code == 429
    assert await running.status("GET", "/localize") == 405
    assert await running.status("POST", "/localized") == 404
    assert (await running.upload()).status_code == 202


def test_a_few_refusals_leave_at_once_and_many_are_held_back_for_moments() -> None:
    pace = RefusalPace(per_s=100, longest_s=0.03)
    assert [pace.hold_s(second) for second in (0.0, 0.5, 1.0)] == [0, 0, 0]
    assert [round(pace.hold_s(2.0), 3) for _ in range(6)] == [0, 0.01, 0.02, 0.03, 0.03, 0.03]
    assert pace.hold_s(2.1) == 0
