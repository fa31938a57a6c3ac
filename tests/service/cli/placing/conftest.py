"""Runs commands against the fake service, on a folder of photos."""

import subprocess
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path

import pytest
from PIL import Image

from panoloc.service.cli.placing.placed_photos import PlacedPhotos, Written
from tests.service.cli.commands import Outcome, Panoloc, fake, panoloc

__all__ = ["fake", "panoloc"]


@pytest.fixture(autouse=True)
def _without_processes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs draw no pictures and export in this process, except where a test is about pictures."""
    if "pictures" not in request.fixturenames:
        monkeypatch.setattr(PlacedPhotos, "draw_overviews", lambda placed, out: Written())
        monkeypatch.setattr(subprocess, "run", run_here)


def run_here(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
    """Run `python -P -m MODULE ARGUMENT...` in this process, which takes a fraction of the time."""
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        code = import_module(f"{command[3]}.__main__").main(command[4:])
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


@pytest.fixture
def pictures() -> None:
    """Let runs draw pictures, and start the processes that they have in earnest."""


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """Return a folder of three photos, each with its name in it, and of what is none."""
    folder = tmp_path / "photos"
    for name in ("hall.jpg", "rooms/a.jpg", "rooms/b.png"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (64, 32), "teal").save(folder / name)
        with (folder / name).open("ab") as file:
            file.write(f" this is {name}".encode())
    (folder / "notes.txt").write_text("no photo")
    (folder / ".hidden.jpg").write_text("no photo")
    return folder


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Return the folder that `place` works in."""
    return tmp_path / "out"


@pytest.fixture
def place(panoloc: Panoloc, tmp_path: Path, out: Path) -> Panoloc:
    """Return a function that places what is in the folder `photos` in map_1; later options win."""

    def call(*options: str | Path) -> Outcome:
        return panoloc("place", tmp_path / "photos", "--map", "map_1", "--out", out, *options)

    return call
