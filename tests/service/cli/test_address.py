"""An address that cannot be listened on is told before anything starts."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoloc.service.host.address import why_not_free
from tests.service.cli.commands import Panoloc


@pytest.fixture
def taken() -> Iterator[int]:
    """Return a port that somebody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield int(server.getsockname()[1])


def test_a_port_that_nobody_listens_on_is_free() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = int(server.getsockname()[1])
    assert why_not_free("127.0.0.1", port) is None
    assert why_not_free("localhost", port) is None
    assert why_not_free("", 0) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0", ""])
def test_a_port_that_somebody_listens_on_is_taken(taken: int, host: str) -> None:
    assert f"the address {host}:{taken} is taken: another program listens on it" in (why_not_free(host, taken) or "")


def test_a_connection_that_has_just_ended_does_not_take_the_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = int(server.getsockname()[1])
        with socket.create_connection(("127.0.0.1", port)), server.accept()[0]:
            pass
    assert why_not_free("127.0.0.1", port) is None


@pytest.mark.parametrize("host", ["no-such-host.invalid", "192.0.2.1", "a" * 80])
def test_an_address_of_another_machine_is_refused(host: str) -> None:
    reason = why_not_free(host, 8000)
    assert reason is not None
    assert "expected an address of this machine" in reason
    assert host in reason
    assert "stop" not in reason


def test_serve_says_at_once_which_address_is_taken_and_what_to_do(
    panoloc: Panoloc, taken: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    done = panoloc("serve", "--port", taken, "--data-dir", tmp_path / "data")
    assert done.code == 1
    for said in (f"127.0.0.1:{taken} is taken", "stop that program", "--port", "PANOLOC_PORT"):
        assert said in done.err
    assert not (tmp_path / "data").exists()
