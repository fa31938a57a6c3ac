"""Fixtures that run commands against the fake service, for the commands of the service and of the lab."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from panoloc.service.cli.entry import run
from tests.service.cli.fake_service import FakeService


@dataclass
class Outcome:
    """What one command left behind."""

    code: int
    out: str
    err: str

    @property
    def said(self) -> str:
        """Return standard error on one line, without the frame around wrong usage."""
        return " ".join(self.err.replace("│", " ").split())

    @property
    def documents(self) -> list[dict[str, Any]]:
        """Return standard output as JSON documents, one per line; fails when anything else is there."""
        return [json.loads(line) for line in self.out.splitlines()]


Panoloc = Callable[..., Outcome]


@pytest.fixture
def fake() -> FakeService:
    """Return a service that localizes everything."""
    return FakeService()


@pytest.fixture
def panoloc(fake: FakeService, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Panoloc:
    """Return a function that runs one command against the fake service."""
    monkeypatch.delenv("PANOLOC_URL", raising=False)
    monkeypatch.delenv("PANOLOC_API_KEY", raising=False)

    def call(*arguments: str | Path) -> Outcome:
        capfd.readouterr()
        code = run([str(argument) for argument in arguments], transport=httpx.MockTransport(fake.handle))
        printed = capfd.readouterr()
        return Outcome(code, printed.out, printed.err)

    return call


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Return a file to upload as a scan."""
    path = tmp_path / "office.ply"
    path.write_bytes(b"ply and more " * 20_000)
    return path


@pytest.fixture
def panorama(tmp_path: Path) -> Path:
    """Return a file to upload as a panorama."""
    path = tmp_path / "photo.jpg"
    path.write_bytes(b"jpeg bytes of photo")
    return path
