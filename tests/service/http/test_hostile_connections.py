"""Connections that send too much, too slowly or nothing, and callers who do not read: each ends, and the others are served."""

import json
import select
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from service.host.embedded_redis import EmbeddedRedis
from service.http.guards.guarded_protocol import guarded_config
from tests.service.http.running_service import SCAN, listening


@contextmanager
def connected(url: str, sent: bytes = b"") -> Iterator[socket.socket]:
    """Open a connection and send what a hostile client sends."""
    host, port = url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        connection.sendall(sent)
        yield connection


def answer(connection: socket.socket) -> tuple[int, dict[str, object]]:
    """Return status and document of what comes back until the connection is closed."""
    data = b""
    while piece := connection.recv(65536):
        data += piece
    head, _, body = data.partition(b"\r\n\r\n")
    assert b"connection: close" in head.lower()
    return int(head.split()[1]), json.loads(body)


def refusals(url: str, limit: str) -> float:
    found = [
        line
        for line in httpx.get(f"{url}/metrics", timeout=60).text.splitlines()
        if f'limit="{limit}"' in line and "_total" in line
    ]
    return float(found[0].rpartition(" ")[2]) if found else 0.0


@pytest.mark.parametrize(
    "head", [b"GET /health HTTP/1.1\r\nA: ", b"GET /", b"GET / HTTP/1.1\r\n"], ids=["header", "path", "many"]
)
def test_a_head_of_megabytes_is_refused_after_kilobytes(
    tmp_path: Path, redis_server: EmbeddedRedis, head: bytes
) -> None:
    with listening(tmp_path, redis_server.url) as url, connected(url, head) as connection:
        num_sent = 0
        piece = b"a: b\r\n" * 10_000 if head.endswith(b"\r\n") else b"a" * 60_000
        with suppress(ConnectionError):
            while num_sent < 24 << 20:
                num_sent += connection.send(piece)
        assert num_sent < 12 << 20  # what the two ends of the connection hold
        assert refusals(url, "header-bytes") == 1


@pytest.mark.parametrize(
    "sent",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET /he alth HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nA b\r\n\r\n",
    ],
    ids=["tls", "path", "header"],
)
def test_what_is_no_http_gets_a_problem_like_every_other_mistake(
    tmp_path: Path, redis_server: EmbeddedRedis, sent: bytes
) -> None:
    with listening(tmp_path, redis_server.url) as url:
        with connected(url, sent) as connection:
            status, problem = answer(connection)
        assert (status, problem["type"]) == (400, "/problems/malformed-request")
        assert "HTTP/1.1" in str(problem["detail"])
        assert refusals(url, "no-http") == 1
        assert httpx.get(f"{url}/health/live", timeout=60).status_code == 200


def test_the_refusal_of_a_head_says_what_to_do(tmp_path: Path, redis_server: EmbeddedRedis) -> None:
    head = b"GET /health HTTP/1.1\r\nHost: localhost\r\nA: " + b"a" * 17_000 + b"\r\n\r\n"
    with listening(tmp_path, redis_server.url) as url, connected(url, head) as connection:
        status, problem = answer(connection)
    assert (status, problem["type"]) == (431, "/problems/head-too-large")
    assert "PANOLOC_MAX_HEADER_BYTES" in str(problem["detail"])


def test_the_limit_of_a_head_counts_every_request_of_a_connection_alone(
    tmp_path: Path, redis_server: EmbeddedRedis
) -> None:
    with listening(tmp_path, redis_server.url) as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(5):
            assert client.get("/health/live", headers={"A": "a" * 10_000}).status_code == 200


@pytest.mark.parametrize("sent", [b"", b"GET /health HTTP/1.1\r\nA: b"], ids=["nothing", "half"])
def test_a_head_that_does_not_come_is_ended(tmp_path: Path, redis_server: EmbeddedRedis, sent: bytes) -> None:
    with (
        listening(tmp_path, redis_server.url, header_timeout_s=0.2) as url,
        connected(url, sent) as connection,
    ):
        assert answer(connection)[0] == 408


def test_connections_beyond_the_limit_of_an_address_are_told_so(tmp_path: Path, redis_server: EmbeddedRedis) -> None:
    with listening(tmp_path, redis_server.url, max_connections_per_address=3) as url:
        with connected(url), connected(url), connected(url):
            time.sleep(0.05)
            with connected(url) as fourth:
                status, problem = answer(fourth)
            assert status == 503
            assert "PANOLOC_MAX_CONNECTIONS_PER_ADDRESS" in str(problem["detail"])
        time.sleep(0.05)
        assert httpx.get(f"{url}/health/live", timeout=60).status_code == 200
        assert refusals(url, "connections-of-address") == 1


@pytest.mark.parametrize("limit", ["max_connections", "max_connections_per_address"])
def test_an_idle_connection_gives_way_to_a_new_one_and_the_longest_idle_first(
    tmp_path: Path, redis_server: EmbeddedRedis, limit: str
) -> None:
    asked = b"GET /health/live HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with listening(tmp_path, redis_server.url, **{limit: 3}) as url, ExitStack() as stack:
        idle = []
        for _ in range(2):
            idle.append(stack.enter_context(connected(url, asked)))
            assert idle[-1].recv(65536).startswith(b"HTTP/1.1 200")
        busy = stack.enter_context(connected(url, asked[:30]))
        assert httpx.get(f"{url}/health/live", timeout=60).status_code == 200
        assert idle[0].recv(1) == b""
        idle[1].sendall(asked)
        assert idle[1].recv(65536).startswith(b"HTTP/1.1 200")
        busy.sendall(asked[30:])
        assert busy.recv(65536).startswith(b"HTTP/1.1 200")


def test_a_connection_outlives_what_clients_and_proxies_keep() -> None:
    """Whoever closes first must be the client: a request that meets a closing connection gets no answer."""
    proxies_keep_s = 60
    assert guarded_config(None, count=None).timeout_keep_alive > proxies_keep_s  # type: ignore[arg-type]


def half_a_query(num_bytes: int) -> bytes:
    head = b'--b\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
    length = len(head) + 2 * num_bytes
    start = "POST /localize HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=b\r\n"
    return f"{start}Content-Length: {length}\r\n\r\n".encode() + head + b"a" * num_bytes


@pytest.mark.slow
@pytest.mark.parametrize("drips", [False, True], ids=["stops", "drips"])
def test_a_body_that_comes_too_slowly_is_ended(tmp_path: Path, redis_server: EmbeddedRedis, drips: bool) -> None:
    with (
        listening(tmp_path, redis_server.url, transfer_timeout_s=0.3, min_bytes_per_s=1e6) as url,
        connected(url, half_a_query(1000)) as connection,
    ):
        ended = threading.Event()

        def drip() -> None:
            while drips and not ended.wait(0.05):
                try:
                    connection.send(b"a")
                except OSError:
                    return

        dripping = threading.Thread(target=drip)
        dripping.start()
        began = time.monotonic()
        connection.settimeout(30)
        head = connection.recv(4096)
        ended.set()
        dripping.join()
        assert b"408" in head.partition(b"\r\n")[0]
        assert time.monotonic() - began < 10
        assert refusals(url, "slow-body") == 1


@pytest.mark.slow
def test_half_open_uploads_hold_no_more_memory_than_allowed(tmp_path: Path, redis_server: EmbeddedRedis) -> None:
    with listening(tmp_path, redis_server.url, max_bytes_in_flight=3_000_000) as url:
        with connected(url, half_a_query(2_000_000)) as first, connected(url, half_a_query(2_000_000)) as second:
            refused, _, _ = select.select([first, second], [], [], 60)
            status, problem = answer(refused[0])
            assert (status, problem["type"]) == (503, "/problems/bytes-in-flight")
            assert "PANOLOC_MAX_BYTES_IN_FLIGHT" in str(problem["detail"])
        assert refusals(url, "bytes-in-flight") == 1
        deadline = time.monotonic() + 60
        status = 503
        while status == 503 and time.monotonic() < deadline:
            # What was held is free as soon as the service has seen that the first has gone.
            status = httpx.post(
                f"{url}/localize", files={"image": ("a.png", b"a" * 2_000_000)}, data={"map_id": "m"}
            ).status_code
        assert status == 415


@pytest.mark.slow
def test_a_caller_who_does_not_read_is_cut_off(tmp_path: Path, redis_server: EmbeddedRedis) -> None:
    with listening(tmp_path, redis_server.url, transfer_timeout_s=0.3, min_bytes_per_s=1e6) as url:
        request = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 400
        with connected(url) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.settimeout(0.2)
            with suppress(TimeoutError, ConnectionError):
                connection.sendall(request)
            deadline = time.monotonic() + 60
            while not refusals(url, "slow-reader") and time.monotonic() < deadline:
                time.sleep(0.05)
        assert refusals(url, "slow-reader") == 1


@pytest.mark.slow
def test_whoever_reads_and_sends_as_usual_is_not_disturbed(tmp_path: Path, redis_server: EmbeddedRedis) -> None:
    limits = {"transfer_timeout_s": 0.3, "header_timeout_s": 0.3, "min_bytes_per_s": 1.0}
    with listening(tmp_path, redis_server.url, **limits) as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(3):
            assert client.post("/maps", files={"file": ("office.ply", SCAN)}).status_code == 202
            time.sleep(0.4)
            assert client.get("/openapi.json").status_code == 200
