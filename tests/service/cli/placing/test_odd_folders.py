"""Folders as people have them: odd names, files that cannot be read, other formats, nothing at all."""

import json
import os
from concurrent.futures import Future
from pathlib import Path

import pytest

from panoloc.service.cli.placing import place
from tests.core.exports.tours import jpeg
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService

EXIT_ERROR, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130
NAMES = (
    "Größe 日本 🏠.jpg",
    "a'b\"c$(d).JPG",
    "-rf.jpg",
    "two  spaces.jpeg",
    "e/same.jpg",
    "f/same.jpg",
    "f/e/same.jpg",
)
NO_UTF8 = os.fsdecode(b"caf\xe9.jpg")


def folder_of(tmp_path: Path, *names: str) -> Path:
    folder = tmp_path / "photos"
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(jpeg())
    return folder


@pytest.mark.slow
def test_photos_of_any_name_are_placed_and_exported(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    out = tmp_path / "out"
    photos = folder_of(tmp_path, *NAMES)
    command = ("place", photos, "--map", "map_1", "--out", out, "--export", "navvis,colmap-rig")
    outcome = panoloc(*command)
    assert (outcome.code, f"{len(NAMES)} photos: {len(NAMES)} localized" in outcome.out) == (0, True)
    assert len(list((out / "navvis").glob("*-pano.*"))) == len(NAMES)
    assert len(list((out / "colmap-rig" / "images" / "front").rglob("*.jpg"))) == len(NAMES)
    assert "are already done" in panoloc(*command).err


def test_a_name_that_is_no_utf_8_is_placed_too(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ("place", folder_of(tmp_path, "a.jpg", NO_UTF8), "--map", "map_1", "--out", out, "--export", "potree")
    outcome = panoloc(*command)
    assert (outcome.code, "2 photos: 2 localized" in outcome.out) == (0, True), outcome.err
    assert os.fsencode(NO_UTF8) in (out / "potree" / "unplaced.txt").read_bytes()
    assert "2 of 2 photos are already done" in panoloc(*command).err


def test_a_file_that_cannot_be_read_fails_alone_and_is_tried_again(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    folder, out = folder_of(tmp_path, "a.jpg"), tmp_path / "out"
    (folder / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    command = ("place", folder, "--map", "map_1", "--out", out)
    outcome = panoloc(*command)
    assert (outcome.code, "1 failed, 1 localized" in outcome.out) == (EXIT_ERROR, True), outcome.err
    assert "gone.jpg\tfailed: expected a file that can be read" in (out / "unplaced.txt").read_text()
    (tmp_path / "nowhere.jpg").write_bytes(jpeg())
    outcome = panoloc(*command)
    assert (outcome.code, "2 localized" in outcome.out) == (0, True), outcome.err


def test_a_folder_without_photos_is_wrong_usage_and_names_what_looks_like_some(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "IMG_1.HEIC").write_bytes(b"x")
    (tmp_path / "photos" / "readme.txt").write_bytes(b"x")
    outcome = panoloc("place", tmp_path / "photos", "--map", "map_1", "--out", tmp_path / "out")
    assert outcome.code == EXIT_USAGE
    assert "expected photos (.jpeg, .jpg, .png, .webp), got none" in outcome.said
    assert "IMG_1.HEIC cannot be read; save photos as JPEG" in outcome.said


def test_photos_of_formats_that_are_not_read_are_told_of(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "a.jpg")
    for name in ("b.heic", "c.TIF", "notes.txt", "cameras.json", ".hidden.txt"):
        (folder / name).write_bytes(b"{}")
    outcome = panoloc("place", folder, "--map", "map_1", "--out", tmp_path / "out")
    assert outcome.code == 0
    assert "left out: b.heic and 1 more cannot be read" in outcome.said
    assert "left out: notes.txt (not a photo, by its name)" in outcome.said


def test_a_folder_that_cannot_be_written_is_told_of(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    outcome = panoloc("place", folder_of(tmp_path, "a.jpg"), "--map", "map_1", "--out", tmp_path / "file" / "out")
    assert (outcome.code, "Error:" in outcome.err) == (EXIT_ERROR, True)
    assert not fake.requests


def test_photos_of_several_cameras_have_theirs_and_an_option_goes_before(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    folder, camera = folder_of(tmp_path, "a.jpg"), {"model": "pinhole", "hfov_deg": 90.0}
    (folder / "cameras.json").write_text(json.dumps({"a.jpg": camera, "b.jpg": 3}))
    assert panoloc("place", folder, "--map", "map_1", "--out", tmp_path / "out").code == 0
    assert json.loads(fake.parts["options"][0])["cameras"] == [camera]
    assert panoloc("place", folder, "--map", "map_1", "--out", tmp_path / "other", "--hfov", "70").code == 0
    assert json.loads(fake.parts["options"][0])["cameras"] == [{"model": "pinhole", "hfov_deg": 70.0}]


def test_ctrl_c_keeps_what_is_under_way_and_says_so(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(futures: dict[Future[object], str]) -> None:
        while not all(future.running() or future.done() for future in futures):
            pass
        raise KeyboardInterrupt

    command = ("place", folder_of(tmp_path, "a.jpg", "b.jpg"), "--map", "map_1", "--out", tmp_path / "out")
    with monkeypatch.context() as changed:
        changed.setattr(place, "as_completed", interrupted)
        outcome = panoloc(*command)
    assert (outcome.code, "run again to resume" in outcome.err) == (EXIT_INTERRUPTED, True)
    assert "2 of 2 photos are already done" in panoloc(*command).err


@pytest.mark.slow
def test_photos_that_are_gone_are_told_of_when_they_are_exported(
    panoloc: Panoloc, fake: FakeService, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert panoloc("place", photos, "--map", "map_1", "--out", out).code == 0
    (photos / "hall.jpg").unlink()
    assert panoloc("export", out, "--export", "tum").code == 0
    assert (out / "tum" / "unplaced.txt").read_text().startswith("hall.jpg\tit was placed, but is no longer in ")
    photos.rename(tmp_path / "moved")
    outcome = panoloc("export", out, "--export", "tum")
    assert (outcome.code, "put them back" in outcome.said) == (EXIT_USAGE, True)
