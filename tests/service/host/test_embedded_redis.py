"""The embedded server with its real process: a tenth of a second each."""

import os
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import redis

from panoloc.service.host.embedded_redis import EmbeddedRedis
from tests.integration.running_service import ROOT, eventually, is_running
from tests.service.started_redis import started_redis


@pytest.fixture
def server() -> Iterator[EmbeddedRedis]:
    with started_redis(16 * 2**20) as server:
        yield server


def answers(server: EmbeddedRedis) -> bool:
    try:
        return bool(redis.Redis.from_url(server.url).ping())
    except redis.RedisError:
        return False


def test_it_answers_on_its_socket_and_on_no_port(server: EmbeddedRedis) -> None:
    client = redis.Redis.from_url(server.url, decode_responses=True)
    client.set("key", "value")
    assert client.get("key") == "value"
    assert client.config_get("port")["port"] == "0"


def test_a_full_server_forgets_what_has_a_lifetime_and_takes_the_new(server: EmbeddedRedis) -> None:
    client = redis.Redis.from_url(server.url)
    names = [f"index:{number}" for number in range(40)]
    for name in names:
        client.set(name, bytes(2**20), ex=3600)
    assert client.exists(names[-1]) == 1
    assert client.exists(*names) < 20  # which of the others are left is chance: all are as old to the second


def test_it_comes_back_after_its_process_was_killed(server: EmbeddedRedis) -> None:
    killed = server.pid
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    assert eventually(lambda: server.pid != killed and answers(server), 5)


def test_after_stop_nothing_is_left(server: EmbeddedRedis) -> None:
    pid = server.pid
    assert pid is not None
    server.stop()
    assert not is_running(pid)
    assert not Path(server.url.removeprefix("unix://")).exists()


@pytest.mark.slow
def test_it_ends_with_a_parent_that_was_killed() -> None:
    program = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from panoloc.service.host.embedded_redis import EmbeddedRedis
        server = EmbeddedRedis(Path(sys.argv[1]))
        server.start()
        print(server.pid, flush=True)
        time.sleep(60)
    """)
    with (
        tempfile.TemporaryDirectory(prefix="panoloc-") as folder,
        subprocess.Popen(
            [sys.executable, "-c", program, folder], stdout=subprocess.PIPE, text=True, cwd=ROOT
        ) as parent,
    ):
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert is_running(pid)
        parent.kill()
        assert eventually(lambda: not is_running(pid), 5)
