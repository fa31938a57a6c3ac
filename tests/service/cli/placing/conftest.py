"""Runs commands against the fake service, on a folder of photos."""

import io
from pathlib import Path

import pytest
from PIL import Image

from panoloc.service.cli.placing.placed_photos import PlacedPhotos, Written
from tests.service.cli.commands import fake, panoloc

__all__ = ["fake", "panoloc"]


@pytest.fixture(autouse=True)
def _without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs draw no pictures, which takes a process each, except where a test is about them."""
    if "pictures" not in request.fixturenames:
        monkeypatch.setattr(PlacedPhotos, "draw_overviews", lambda placed, out: Written())


@pytest.fixture
def pictures() -> tuple[str, str]:
    """Return the names of the pictures, and let runs draw them."""
    return "plan.png", "contact-sheet.jpg"


NAMES = ("hall.jpg", "rooms/a.jpg", "rooms/b.png")


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """Return a folder of three photos, each with its name in it, and of what is none."""
    folder = tmp_path / "photos"
    for name in NAMES:
        out = io.BytesIO()
        Image.new("RGB", (64, 32), "teal").save(out, "PNG" if name.endswith("png") else "JPEG")
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(out.getvalue() + f" this is {name}".encode())
    (folder / "notes.txt").write_text("no photo")
    (folder / ".hidden.jpg").write_text("no photo")
    return folder
