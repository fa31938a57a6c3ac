"""Connections that send too much, too slowly or nothing, and callers who do not read: each ends, and the others are served."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.http import server
from panoloc.service.http.guards import slow_clients
from panoloc.service.http.server import server_config
from panoloc.service.limits import capacity
from tests.service.http.running_service import SCAN, Listen, listening_server


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_clients, "TIMEOUT_S", 0.3)
    monkeypatch.setattr(slow_clients, "BYTES_PER_S", 1e6)


@contextmanager
def connected(url: str, sent: bytes = b"") -> Iterator[socket.socket]:
    """Open a connection and send what a hostile client sends."""
    host, port = url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        connection.sendall(sent)
        yield connection


def eventually(holds: Callable[[], object]) -> bool:
    deadline = time.monotonic() + 60
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.02)
    return bool(holds())


def refusals(url: str, limit: str) -> float:
    lines = httpx.get(f"{url}/metrics", timeout=60).text.splitlines()
    found = [line for line in lines if f'limit="{limit}"' in line and "_total" in line]
    return float(found[0].rpartition(" ")[2]) if found else 0.0


@pytest.mark.parametrize(
    "head", [b"GET /health HTTP/1.1\r\nA: ", b"GET /", b"GET / HTTP/1.1\r\n"], ids=["header", "path", "many"]
)
def test_a_head_of_megabytes_is_refused_after_kilobytes(listen: Listen, head: bytes) -> None:
    with listen() as url, connected(url, head) as connection:
        num_sent = 0
        piece = b"a: b\r\n" * 10_000 if head.endswith(b"\r\n") else b"a" * 60_000
        with suppress(ConnectionError):
            while num_sent < 24 << 20:
                num_sent += connection.send(piece)
        assert num_sent < 12 << 20  # what the two ends of the connection hold


def test_the_refusal_of_a_large_head_says_what_to_do_and_counts_each_request_alone(listen: Listen) -> None:
    with listen() as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(3):
            assert client.get("/health/live", headers={"A": "a" * 10_000}).status_code == 200
        refused = client.get("/health/live", headers={"A": "a" * 17_000})
        assert (refused.status_code, refused.json()["type"]) == (431, "/problems/head-too-large")
        assert "send long values in the body" in refused.json()["detail"]
        assert refusals(url, "header-bytes") == 1


def answer(connection: socket.socket) -> bytes:
    """Return the first line of an answer to /health/live, and read it to the end, which may come on its own."""
    received = b""
    while not received.endswith(b"}"):
        received += connection.recv(4096)
    return received.partition(b"\r\n")[0]


@pytest.mark.parametrize("sent", [b"", b"GET /health HTTP/1.1\r\nA: b"], ids=["nothing", "half"])
def test_a_head_that_does_not_come_ends_its_connection_and_no_idle_one(
    listen: Listen, monkeypatch: pytest.MonkeyPatch, sent: bytes
) -> None:
    monkeypatch.setattr(server, "_HEAD_TIMEOUT_S", 0.2)
    asked = b"GET /health/live HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with listen() as url, connected(url, asked) as idle:
        assert b" 200 " in answer(idle)
        with connected(url, sent) as slow:
            assert slow.recv(1) == b""
        idle.sendall(asked)
        assert b" 200 " in answer(idle)


@pytest.mark.parametrize(
    "sent",
    [b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", b"GET /he alth HTTP/1.1\r\n\r\n"],
    ids=["tls", "path"],
)
def test_what_is_no_http_is_refused_and_others_are_served(listen: Listen, sent: bytes) -> None:
    with listen() as url:
        with connected(url, sent) as connection:
            # All that comes until the connection is closed.
            assert b"".join(iter(lambda: connection.recv(4096), b"")).startswith(b"HTTP/1.1 400 ")
        assert httpx.get(f"{url}/health/live", timeout=60).status_code == 200


def test_a_connection_outlives_what_clients_and_proxies_keep() -> None:
    """The client must close first: a request that meets a closing connection gets no answer."""
    proxies_keep_s = 60
    assert server_config(None).timeout_keep_alive > proxies_keep_s


def half_a_query(num_bytes: int) -> bytes:
    head = b'--b\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
    length = len(head) + 2 * num_bytes
    start = "POST /localize HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=b\r\n"
    return f"{start}Content-Length: {length}\r\n\r\n".encode() + head + b"a" * num_bytes


@pytest.mark.parametrize("drips", [False, True], ids=["stops", "drips"])
def test_a_body_that_comes_too_slowly_is_ended(listen: Listen, impatient: None, drips: bool) -> None:
    with listen() as url, connected(url, half_a_query(1000)) as connection:
        ended = threading.Event()

        def drip() -> None:
            with suppress(OSError):
                while drips and not ended.wait(0.05):
                    connection.send(b"a")

        dripping = threading.Thread(target=drip)
        dripping.start()
        assert b" 408 " in connection.recv(4096).partition(b"\r\n")[0]
        ended.set()
        dripping.join()
        assert refusals(url, "slow-body") == 1


def test_the_rest_of_a_refused_body_may_not_drip_for_ever(listen: Listen, impatient: None) -> None:
    """It is small enough for the connection to be kept, if it came."""
    refused = half_a_query(1000).replace(b"POST /localize", b"POST /nowhere_", 1)
    with listen() as url, connected(url, refused) as connection:
        assert b" 404 " in connection.recv(4096).partition(b"\r\n")[0]
        with suppress(ConnectionError):
            while connection.recv(4096):
                connection.send(b"a")


def query(url: str) -> httpx.Response:
    image = {"image": ("a.png", b"a" * 2_000_000)}
    return httpx.post(f"{url}/localize", files=image, data={"map_id": "m"}, timeout=60)


def test_half_open_uploads_hold_no_more_memory_than_allowed(listen: Listen, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "_LARGEST_IMAGES_OF_CALLER", 1)
    with listen(max_image_bytes=3_000_000) as url:

        def beside_half_a_query() -> httpx.Response:
            """Return the answer to a query; where its bytes came first, the half one was refused in its place."""
            with connected(url, half_a_query(2_000_000)):
                return query(url)

        answers = (beside_half_a_query() for _ in range(100))
        refused = next(answer for answer in answers if answer.status_code == 503)
        assert refused.json()["type"] == "/problems/bytes-in-flight"
        assert "PANOLOC_MAX_IMAGE_BYTES" in refused.json()["detail"]
        assert refusals(url, "bytes-in-flight") >= 1
        # What was held is free as soon as the service has seen that the first client has gone.
        assert eventually(lambda: query(url).status_code == 415)


@pytest.mark.slow
def test_a_caller_who_does_not_read_is_cut_off(
    tmp_path: Path, redis_server: EmbeddedRedis, impatient: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_SEND_TIMEOUT_S", 1)
    request = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 400
    with listening_server(tmp_path, redis_server.url) as (url, running), connected(url) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.settimeout(0.2)
        with suppress(TimeoutError, ConnectionError):
            connection.sendall(request)
        assert eventually(lambda: refusals(url, "slow-reader") == 1)
        assert eventually(lambda: not running.server_state.connections)


@pytest.mark.slow
def test_whoever_reads_and_sends_as_usual_is_not_disturbed(listen: Listen, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pauses between requests count for nothing."""
    monkeypatch.setattr(slow_clients, "TIMEOUT_S", 0.2)
    with listen() as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(2):
            assert client.post("/maps", files={"file": ("office.ply", SCAN)}).status_code == 202
            time.sleep(0.3)
            assert client.get("/openapi.json").status_code == 200
