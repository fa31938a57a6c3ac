"""Signals and renewed certificates against the real uvicorn, with an application of four lines and a pool that counts."""

import asyncio
import os
import signal
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import httpx
import pytest

from panoloc.service.host.certificates import make_certificate
from panoloc.service.http.request_context import RecentErrors, RequestContext
from panoloc.service.http.server import DrainingServer, server_config
from panoloc.service.jobs import PoolState
from panoloc.service.metrics import Metrics
from tests.integration.running_service import eventually


class CountingPool:
    """Has as many requests under way as it is told."""

    def __init__(self, num_under_way: int = 0) -> None:
        self.num_under_way = num_under_way
        self.is_draining = False
        self.end_server: Callable[[], None] = lambda: None

    def begin_drain(self) -> None:
        self.is_draining = True

    def finish(self) -> None:
        assert self.is_draining
        self.num_under_way = 0


async def application(scope: dict[str, Any], receive: Any, send: Any) -> None:
    while scope["type"] == "lifespan":
        event = (await receive())["type"]
        await send({"type": f"{event}.complete"})
        if event == "lifespan.shutdown":
            return


async def run_until_stopped(pool: CountingPool, drain_s: float, *steps: Any) -> float:
    """Start the server, perform the steps 0.2 s apart, and return the seconds from the first step to the end."""
    server = DrainingServer(server_config(application, port=0), pool, drain_s)
    pool.end_server = server.end
    serving = asyncio.create_task(server.serve())
    while not server.started:
        await asyncio.sleep(0.01)
    began = time.monotonic()
    for step in steps:
        step()
        await asyncio.sleep(0.2)
    await asyncio.wait_for(serving, 10)
    return time.monotonic() - began


def send(received: signal.Signals) -> Any:
    return lambda: os.kill(os.getpid(), received)


@pytest.mark.parametrize("received", [signal.SIGTERM, signal.SIGINT])
def test_an_idle_service_ends_at_once(received: signal.Signals) -> None:
    pool = CountingPool()
    assert asyncio.run(run_until_stopped(pool, 30, send(received))) < 3
    assert pool.is_draining


def test_what_is_under_way_is_finished_first() -> None:
    pool = CountingPool(1)
    took = asyncio.run(run_until_stopped(pool, 30, send(signal.SIGTERM), lambda: None, pool.finish))
    assert 0.4 <= took < 5


def test_what_takes_too_long_is_left() -> None:
    assert 0.3 <= asyncio.run(run_until_stopped(CountingPool(1), 0.3, send(signal.SIGTERM))) < 5


def test_who_waits_longer_than_the_drain_is_told_to_try_again() -> None:
    async def never_answers(scope: dict[str, Any], receive: Any, send: Any) -> None:
        await (application(scope, receive, send) if scope["type"] == "lifespan" else asyncio.sleep(60))

    async def answered() -> httpx.Response:
        metrics = Metrics(lambda: PoolState(True, None, 1, 0, 0, {}, 0), dict)
        app = RequestContext(cast(Any, never_answers), metrics, RecentErrors())
        server = DrainingServer(server_config(app, port=0, timeout_graceful_shutdown=1), CountingPool(1), drain_s=0.2)
        serving = asyncio.create_task(server.serve())
        while not server.started:
            await asyncio.sleep(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        async with httpx.AsyncClient(timeout=10) as client:
            waiting = asyncio.create_task(client.get(f"http://127.0.0.1:{port}/"))
            await asyncio.sleep(0.3)
            server.handle_exit(signal.SIGTERM, None)
            reply = await waiting
        await serving
        return reply

    reply = asyncio.run(answered())
    assert (reply.status_code, reply.headers["content-type"]) == (503, "application/problem+json")
    assert int(reply.headers["Retry-After"]) > 0
    assert "send the request again" in reply.json()["detail"]


def test_one_request_to_end_that_comes_as_two_signals_is_one() -> None:
    pool = CountingPool(1)

    def twice() -> None:
        send(signal.SIGTERM)()
        send(signal.SIGTERM)()

    assert asyncio.run(run_until_stopped(pool, 30, twice, lambda: None, pool.finish)) >= 0.4


def test_a_second_signal_ends_the_drain_and_leaves_no_traceback() -> None:
    """In a process of its own: pytest's loops and handlers would keep what a process logs at its end."""
    program = (
        "import asyncio, logging, signal\n"
        "from tests.service.http.test_server import CountingPool, run_until_stopped, send\n"
        "logging.basicConfig(level=logging.INFO)\n"
        "asyncio.run(run_until_stopped(CountingPool(1), 30, send(signal.SIGTERM), send(signal.SIGTERM)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=25)
    assert "ending at once" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_service_that_has_lost_its_workers_waits_for_nothing() -> None:
    pool = CountingPool(1)
    assert asyncio.run(run_until_stopped(pool, 30, lambda: pool.end_server())) < 5


def test_a_renewed_certificate_is_used_without_a_restart_unless_it_is_of_another_key(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    certificate, key = own / "server.crt", own / "server.key"
    make_certificate(own, ())
    server = DrainingServer(
        server_config(application, port=0, ssl_certfile=certificate, ssl_keyfile=key), CountingPool(), 0
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    assert eventually(lambda: server.started, 10)
    port = server.servers[0].sockets[0].getsockname()[1]

    def served() -> bytes:
        return ssl.PEM_cert_to_DER_cert(ssl.get_server_certificate(("127.0.0.1", port)))

    def written() -> bytes:
        return ssl.PEM_cert_to_DER_cert(certificate.read_text())

    try:
        assert served() == written()
        make_certificate(own, ())
        assert eventually(lambda: served() == written(), 10)
        renewed = written()
        make_certificate(other, ())
        certificate.write_bytes((other / "server.crt").read_bytes())
        assert eventually(lambda: "the certificate cannot be renewed" in caplog.text, 10)
        assert served() == renewed
        make_certificate(own, ())
        assert eventually(lambda: served() == written(), 10)
    finally:
        server.end()
        thread.join()
