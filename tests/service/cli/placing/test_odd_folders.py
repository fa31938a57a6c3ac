"""Folders as people have them: odd names, files that cannot be read, other formats, nothing at all."""

import json
import os
from concurrent.futures import Future
from pathlib import Path

import httpx
import pytest

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.placing import place as place_command
from tests.core.exports.tours import jpeg
from tests.core.image.picture_files import heic, phone_exif, picture
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


def folder_of(tmp_path: Path, *names: str, data: bytes | None = None) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data or jpeg())
    return folder


def test_photos_of_any_name_are_placed_and_exported(place: Panoloc, tmp_path: Path, out: Path) -> None:
    folder_of(tmp_path, *NAMES)
    outcome = place("--export", "navvis,colmap-rig")
    assert (outcome.code, f"{len(NAMES)} photos: {len(NAMES)} localized" in outcome.out) == (0, True)
    assert len(list((out / "navvis").glob("*-pano.*"))) == len(NAMES)
    assert len(list((out / "colmap-rig" / "images" / "front").rglob("*.jpg"))) == len(NAMES)
    assert "already done: " in place().err


def test_a_name_that_is_no_utf_8_is_placed_too(place: Panoloc, tmp_path: Path, out: Path) -> None:
    folder_of(tmp_path, "a.jpg", NO_UTF8)
    outcome = place("--export", "potree")
    assert (outcome.code, "2 photos: 2 localized" in outcome.out) == (0, True), outcome.err
    assert os.fsencode(NO_UTF8) in (out / "potree" / "unplaced.txt").read_bytes()
    assert "already done: 2 of 2 photos" in place().err


def test_the_longest_name_of_a_file_does_not_end_the_run(place: Panoloc, tmp_path: Path) -> None:
    folder_of(tmp_path, "a.jpg", f"{'x' * 251}.jpg")
    outcome = place("--export", "tum")
    assert (outcome.code, "2 photos: 2 localized" in outcome.out) == (0, True), outcome.err
    assert "already done: 2 of 2 photos" in place().err


def test_an_out_that_cannot_be_written_is_named(panoloc: Panoloc, tmp_path: Path) -> None:
    folder_of(tmp_path, "a.jpg")
    (tmp_path / "file").touch()
    outcome = panoloc("place", tmp_path / "photos", "--map", "map_1", "--out", tmp_path / "file" / "out")
    assert (outcome.code, "expected a folder that can be written" in outcome.said) == (EXIT_ERROR, True)


def test_a_file_that_cannot_be_read_fails_alone_and_is_tried_again(place: Panoloc, tmp_path: Path, out: Path) -> None:
    (folder_of(tmp_path, "a.jpg") / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    outcome = place()
    assert (outcome.code, "1 failed, 1 localized" in outcome.out) == (EXIT_ERROR, True), outcome.err
    assert "gone.jpg\tfailed: expected a file that can be read" in (out / "unplaced.txt").read_text()
    (tmp_path / "nowhere.jpg").write_bytes(jpeg())
    outcome = place()
    assert (outcome.code, "2 localized" in outcome.out) == (0, True), outcome.err


def test_a_folder_without_photos_is_wrong_usage_and_names_what_looks_like_some(place: Panoloc, tmp_path: Path) -> None:
    folder_of(tmp_path, "IMG_1.DNG", "readme.txt", data=b"x")
    outcome = place()
    assert outcome.code == EXIT_USAGE
    assert "expected photos (.avif, .heic, .heif, .hif, .jpeg, .jpg, .png, .webp), got none" in outcome.said
    assert "IMG_1.DNG cannot be read; save photos as JPEG, PNG, WebP, HEIC or AVIF" in outcome.said


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_panoramas_in_heic_are_placed_and_exported_as_jpeg(
    place: Panoloc, fake: FakeService, tmp_path: Path, out: Path
) -> None:
    folder_of(tmp_path, "a.HEIC", data=heic(picture(128, 64), phone_exif()))
    outcome = place("--export", "potree")
    assert (outcome.code, "1 localized" in outcome.out) == (0, True), outcome.err
    assert (out / "potree" / "a.HEIC.jpg").read_bytes().startswith(b"\xff\xd8\xff")
    assert "a.HEIC.jpg\t" in (out / "potree" / "coordinates.txt").read_text()
    assert (out / "contact-sheet.jpg").exists()


def test_photos_of_formats_that_are_not_read_are_told_of(place: Panoloc, tmp_path: Path) -> None:
    folder_of(tmp_path, "a.jpg")
    folder_of(tmp_path, "b.dng", "c.TIF", "notes.txt", "cameras.json", ".DS_Store", "._a.jpg", data=b"{}")
    outcome = place()
    assert outcome.code == 0
    assert "left out: b.dng and 1 more cannot be read" in outcome.said
    assert "left out: ._a.jpg and 1 more (not a photo, by its name)" in outcome.said
    assert "1 photo: 1 localized" in outcome.out


def test_a_folder_that_cannot_be_written_is_told_of(place: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    photo = folder_of(tmp_path, "a.jpg") / "a.jpg"
    outcome = place("--out", photo / "out")
    assert (outcome.code, "Error:" in outcome.err) == (EXIT_ERROR, True)
    assert not fake.requests


def test_photos_of_several_cameras_have_theirs_and_an_option_goes_before(
    place: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    folder, camera = folder_of(tmp_path, "a.jpg"), {"model": "pinhole", "hfov_deg": 90.0}
    cameras = folder / "cameras.json"
    for wrong, said in (("{bad", "expected JSON"), (json.dumps({"A.jpg": camera}), "got 'A.jpg'")):
        cameras.write_text(wrong)
        outcome = place()
        assert (outcome.code, said in outcome.said, fake.requests) == (ExitCode.USAGE, True, [])
    cameras.write_text(json.dumps({"a.jpg": camera}))
    assert place().code == 0
    assert json.loads(fake.parts["options"][0])["cameras"] == [camera]
    camera["hfov_deg"] = 80.0
    cameras.write_text(json.dumps({"a.jpg": camera}))
    assert place().code == 0
    assert json.loads(fake.parts["options"][0])["cameras"] == [camera]
    assert place("--out", tmp_path / "other", "--hfov", "70").code == 0
    of_photos = {"model": "pinhole", "hfov_deg": 70.0, "unless_panorama": True}
    assert json.loads(fake.parts["options"][0])["cameras"] == [of_photos]


def test_a_run_whose_service_goes_away_can_be_resumed_and_says_so(
    place: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    folder_of(tmp_path, "a.jpg", "b.jpg")

    def gone_after_the_first(request: httpx.Request) -> None:
        fake.down = ("POST", "/localize") in fake.requests[:-1]
        if fake.down:
            raise httpx.ConnectError("Connection refused", request=request)

    fake.on_request = gone_after_the_first
    outcome = place("--parallel", "1")
    assert (outcome.code, "run again to resume" in outcome.err) == (ExitCode.UNREACHABLE, True)
    fake.down, fake.on_request = False, lambda request: None
    assert "already done: 1 of 2 photos" in place().err


def test_ctrl_c_keeps_what_is_under_way_and_says_so(
    place: Panoloc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(futures: dict[Future[object], str]) -> None:
        while not all(future.running() or future.done() for future in futures):
            pass
        raise KeyboardInterrupt

    folder_of(tmp_path, "a.jpg", "b.jpg")
    with monkeypatch.context() as changed:
        changed.setattr(place_command, "as_completed", interrupted)
        outcome = place()
    assert (outcome.code, "run again to resume" in outcome.err) == (EXIT_INTERRUPTED, True)
    assert "already done: 2 of 2 photos" in place().err


def test_photos_that_are_gone_are_told_of_when_they_are_exported(
    place: Panoloc, panoloc: Panoloc, photos: Path, tmp_path: Path, out: Path
) -> None:
    assert place().code == 0
    (photos / "hall.jpg").unlink()
    assert panoloc("export", out, "--export", "tum").code == 0
    assert (out / "tum" / "unplaced.txt").read_text().startswith("hall.jpg\tit was placed, but is no longer in ")
    photos.rename(tmp_path / "moved")
    outcome = panoloc("export", out, "--export", "tum")
    assert (outcome.code, "put them back" in outcome.said) == (EXIT_USAGE, True)
