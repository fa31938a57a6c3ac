"""A service in the background: where it is started, and what is told while it comes up."""

import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import httpx
import pytest

from panoloc.lab.background_service import (
    BackgroundService,
    StartError,
    own_service,
    start_in_background,
    wait_until_ready,
)
from panoloc.service.client import JsonClient, WaitTimeoutError
from tests.service.cli.fake_service import FakeService


def test_a_service_that_ends_while_it_starts_shows_the_end_of_its_log(fake: FakeService, tmp_path: Path) -> None:
    log = tmp_path / "service.log"
    log.write_text("first line\nport 8000 is in use\n")
    ended = subprocess.Popen([sys.executable, "-c", "raise SystemExit(3)"])
    ended.wait()
    with (
        JsonClient("http://127.0.0.1:8000", transport=httpx.MockTransport(fake.handle)) as client,
        pytest.raises(StartError, match=r"exit code 3(.|\n)*port 8000 is in use"),
    ):
        wait_until_ready(client, BackgroundService(ended, log), lambda text: None)


def test_waiting_tells_what_the_service_waits_for(fake: FakeService, tmp_path: Path) -> None:
    not_yet = [httpx.Response(503, json={"status": "starting", "title": "x", "waiting_for": ["a worker"]})]

    def handle(request: httpx.Request) -> httpx.Response:
        return not_yet.pop() if not_yet else fake.handle(request)

    heard: list[str] = []
    with JsonClient("http://127.0.0.1:8000", transport=httpx.MockTransport(handle)) as client:
        wait_until_ready(client, None, heard.append)
    assert heard == ["the service waits for a worker"]


def test_a_service_that_never_becomes_ready_is_stopped_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[BackgroundService] = []

    def start(url: str, log: Path, settings: Mapping[str, str], survives: bool) -> BackgroundService:
        assert settings["PANOLOC_MAX_TIMEOUT_S"] == "900"
        started.append(BackgroundService(subprocess.Popen(["sleep", "60"]), Path(settings["PANOLOC_DATA_DIR"])))
        return started[0]

    monkeypatch.setattr("panoloc.lab.background_service.start_in_background", start)
    monkeypatch.setattr("panoloc.lab.background_service._START_LIMIT_S", 0.0)
    with pytest.raises(WaitTimeoutError), own_service({"PANOLOC_MAX_TIMEOUT_S": "900"}, tmp_path / "service.log"):
        pass
    assert started[0].process.poll() is not None
    assert not started[0].log_file.parent.exists()


def test_only_plain_http_on_this_machine_can_be_started(tmp_path: Path) -> None:
    with pytest.raises(StartError):
        start_in_background("https://localhost:8000", tmp_path / "log")


def test_no_service_is_started_in_the_background_where_another_program_listens(tmp_path: Path) -> None:
    log = tmp_path / "demo" / "service.log"
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = int(server.getsockname()[1])
        with pytest.raises(StartError, match=rf"127\.0\.0\.1:{taken} is taken(.|\n)*--url"):
            start_in_background(f"http://127.0.0.1:{taken}", log)
    assert not log.exists()
