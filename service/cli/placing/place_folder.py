"""The folder that `panoloc place` works in: the question, and the result of each photo as soon as it is known.

place.json              the question: photos, maps and options; another question needs another folder
results/a.jpg.json      the result of FOLDER/a.jpg, and the batch of the service that has it
maps/map_x.json, .ply   the maps with photos in them, and their points, so that exports need no service
unplaced.txt            the photos without a pose, with the reason
plan.png, contact-sheet.jpg   where the photos are in the scan, and the result of each
"""

import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import typer

from panoloc.core.options import CAMERAS_FILE
from panoloc.core.scan.file_names import display_name
from panoloc.service.batches.archive import IMAGE_ENDINGS
from panoloc.service.batches.tour import Photo, why_left_out
from panoloc.service.cli.placing.placed_photos import PlacedPhotos, replace_file
from panoloc.service.client import JsonObject
from panoloc.service.jobs import Result

_QUESTION = "place.json"
_LOCK = ".lock"
_OF_THE_PHOTO = (413, 415, 422)
_OPTIONS_REFUSED = "/problems/invalid-options"
_LONGEST_NAME = 240  # bytes of a file name that leave room for what is added to it
_UNREAD_ENDINGS = frozenset({".tif", ".tiff", ".dng", ".insp", ".jxl", ".jp2", ".bmp", ".gif"})


@dataclass(frozen=True)
class Question:
    """What is asked. photos: their folder, absolute. options: those of `POST /localize`."""

    photos: str
    map_ids: list[str]
    tag: str | None
    options: JsonObject


@dataclass(frozen=True)
class FolderFiles:
    """Names of files below their folder, sorted. unread: photos in formats that are not read. others: of hidden files the images alone."""

    photos: list[str]
    unread: list[str]
    others: list[str]


class PlaceFolder:
    """Reads and writes the folder. Files are replaced atomically: a kill leaves the old one or the new one."""

    def __init__(self, folder: Path, question: Question) -> None:
        self.folder = folder
        self.question = question
        self._photos = Path(question.photos)
        self._cameras = _cameras_in(self._photos / CAMERAS_FILE)

    @classmethod
    @contextmanager
    def held(cls, folder: Path, question: Question) -> Iterator["PlaceFolder"]:
        """Lock and yield a folder: a new one, one with the same question, or one without answers.

        The operating system holds the lock, so that a killed process leaves none. Raises typer.BadParameter.
        """
        if folder.resolve() == Path(question.photos):
            raise _wrong_out(
                "expected another --out than the folder of the photos, where exports would be "
                f"taken for photos; try {folder / 'placed'}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _LOCK).open("ab") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise _wrong_out(
                    f"expected an unused folder, but another `panoloc place` works in {folder}; "
                    "wait until it ends, or choose another --out"
                ) from error
            found = _read(folder / _QUESTION)
            results = (_read(file) or {} for file in (folder / "results").rglob("*.json"))
            if found is None or (found != asdict(question) and not any(map(_has_answer, results))):
                _write(folder / _QUESTION, asdict(question))
            elif found != asdict(question):
                raise _wrong_out(
                    f"expected a new folder, or one of a run with the same photos, maps and options, but {folder} is "
                    "from a different run; choose another --out"
                )
            yield cls(folder, question)

    @classmethod
    def open(cls, folder: Path) -> "PlaceFolder | None":
        """Open a folder that `panoloc place` made, None for another. Raises typer.BadParameter if the photos are gone."""
        found = _read(folder / _QUESTION)
        if found is None:
            return None
        question = Question(**found)
        if not Path(question.photos).is_dir():
            message = f"expected the photos in {question.photos}, but there is no such folder; put them back"
            raise typer.BadParameter(message, param_hint="SOURCE")
        return cls(folder, question)

    def files(self) -> FolderFiles:
        """Return the files in the folder of the photos, without those in this folder or another of its kind."""
        found = FolderFiles([], [], [])
        for name in sorted(path.relative_to(self._photos).as_posix() for path in self._walk()):
            # No photo is hidden: a Mac leaves ._a.jpg beside a.jpg.
            ending = "" if "/." in f"/{name}" else PurePosixPath(name).suffix.lower()
            kind = (
                found.photos if ending in IMAGE_ENDINGS else found.unread if ending in _UNREAD_ENDINGS else found.others
            )
            if name != CAMERAS_FILE:
                kind.append(name)
        return found

    def photo(self, name: str) -> Photo:
        """Return a photo; without a result if it has none, or if its file or its entry in `cameras.json` has changed since."""
        file, found = self._photos / name, _read(self._result_file(name))
        is_current = (
            found is not None and found["file"] == _fingerprint(file) and found.get("camera") == self.camera(name)
        )
        return Photo(name, file, found["result"] if found is not None and is_current else None)

    def camera(self, name: str) -> JsonObject | None:
        """Return the camera that `cameras.json` in the folder of the photos gives a photo, an entry of `cameras`."""
        found = self._cameras.get(name)
        return found if isinstance(found, dict) else None

    def put_result(self, photo: Photo, result: Result) -> None:
        """Store the result of a photo."""
        assert photo.image is not None
        camera = self.camera(photo.name)
        document = {"name": photo.name, "file": _fingerprint(photo.image), "camera": camera, "result": result}
        # Another answer to the same file is of the same batch.
        former = {} if photo.result is None else self._document(photo)
        _write(self._result_file(photo.name), {**former, **document})

    def unkept(self) -> list[Photo]:
        """Return the photos with an answer that no batch of the service has yet."""
        return self._by_batch().get(None, [])

    def kept(self) -> dict[str, dict[str, Photo]]:
        """Return the photos that batches of the service have, by the id of the batch and their name."""
        found = {batch: {photo.name: photo for photo in photos} for batch, photos in self._by_batch().items()}
        return {batch: photos for batch, photos in found.items() if batch is not None}

    def note_batch(self, photos: Iterable[Photo], batch_id: str) -> None:
        """Store in which batch of the service photos are."""
        for photo in photos:
            _write(self._result_file(photo.name), {**self._document(photo), "batch": batch_id})

    def placed(self) -> PlacedPhotos:
        """Return all photos with their results, as exports and pictures need them."""
        photos = [self.photo(name) for name in self.files().photos]
        kept = (_read(file) for file in (self.folder / "results").rglob("*.json"))
        gone = sorted(each["name"] for each in kept if each and not (self._photos / each["name"]).exists())
        reason = f"it was placed, but is no longer in {self._photos}"
        made_unix_s = (self.folder / _QUESTION).stat().st_mtime
        return PlacedPhotos(photos, made_unix_s, self.folder / "maps", dict.fromkeys(gone, reason))

    def write_unplaced(self, photos: Sequence[Photo]) -> Path:
        """Write the list of photos without a reliable pose, with the reasons."""
        reasons = ((photo.name, why_left_out(photo.result, None, include_ambiguous=False)) for photo in photos)
        lines = (
            f"{display_name(name)}\t{' '.join(reason.split())}\n" for name, reason in reasons if reason is not None
        )
        target = self.folder / "unplaced.txt"
        # File names that are not UTF-8 are written as they are.
        replace_file(target, os.fsencode("".join(lines)))
        return target

    def _walk(self) -> Iterator[Path]:
        left_out = self.folder.resolve()
        for folder, folders, files in os.walk(self._photos):
            here = Path(folder)
            if here != self._photos and _QUESTION in files:
                folders[:] = []
                continue
            folders[:] = [name for name in folders if not name.startswith(".") and (here / name).resolve() != left_out]
            yield from (here / name for name in files if name[0] != "." or Path(name).suffix.lower() in IMAGE_ENDINGS)

    def _by_batch(self) -> dict[str | None, list[Photo]]:
        """Return the photos with an answer by the id of the batch that has them, None for those without."""
        found: dict[str | None, list[Photo]] = {}
        for photo in (self.photo(name) for name in self.files().photos):
            if photo.result is not None and "answer" in photo.result:
                found.setdefault(self._document(photo).get("batch"), []).append(photo)
        return found

    def _document(self, photo: Photo) -> JsonObject:
        return _read(self._result_file(photo.name)) or {}

    def _result_file(self, name: str) -> Path:
        file = self.folder / "results" / f"{name}.json"
        own = os.fsencode(file.name)
        return file if len(own) <= _LONGEST_NAME else file.with_name(f"{hashlib.sha256(own).hexdigest()}.json")


def _has_answer(document: JsonObject) -> bool:
    return "answer" in document.get("result", {})


def is_final(result: Result | None) -> bool:
    """Tell whether another run would not change a result: an answer, or a fault of the photo itself."""
    if result is None or result["status"] != "failed":
        return result is not None
    return result["error"].get("status") in _OF_THE_PHOTO and not are_options_refused(result["error"])


def are_options_refused(problem: JsonObject) -> bool:
    """Tell whether a problem document is about the options, not about the photo."""
    return str(problem.get("type", "")).endswith(_OPTIONS_REFUSED)


def _cameras_in(file: Path) -> JsonObject:
    """Return the cameras by the names of their photos, none without the file. Raises typer.BadParameter for a file that is none."""
    if not file.exists():
        return {}
    found = _read(file)
    if found is None:
        raise typer.BadParameter(
            f"expected JSON, an object of cameras by the names of photos, in {file}; mend it", param_hint="FOLDER"
        )
    if unknown := [name for name in found if not (file.parent / name).is_file()]:
        message = (
            f"expected the names of photos in {file}, got {unknown[0]!r}, of which there is no file; mend or remove it"
        )
        raise typer.BadParameter(message, param_hint="FOLDER")
    return found


def _wrong_out(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="--out")


def _fingerprint(photo: Path) -> list[int]:
    """Return numbers that change with a file; none for a missing one, such as a broken link."""
    try:
        found = photo.stat()
    except OSError:
        return []
    return [found.st_size, found.st_mtime_ns]


def _read(file: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def _write(file: Path, document: JsonObject) -> None:
    # A backslash escapes file names that are not UTF-8.
    replace_file(file, (json.dumps(document, ensure_ascii=False) + "\n").encode(errors="backslashreplace"))
