"""The folder that `panoloc place` works in: the question, and the result of each photo as soon as it is known.

place.json              the question: photos, maps and options; another question needs another folder
results/a.jpg.json      the result of FOLDER/a.jpg
maps/map_x.json, .ply   the maps with photos in them, and their points, so that exports need no service
unplaced.txt            the photos without a pose, with the reason
plan.png, contact-sheet.jpg   where the photos are in the scan, and the result of each
"""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import typer

from panoloc.core.options import CAMERAS_FILE
from panoloc.core.shown_name import shown_name
from panoloc.service.batches.tour import TourDocument, maps_of
from panoloc.service.cli.placing.photo_files import PhotoFiles, photo_files
from panoloc.service.client import JsonObject
from panoloc.service.jobs import Result

_QUESTION = "place.json"
_LOCK = ".lock"
_OF_THE_PHOTO = (413, 415, 422)
_OPTIONS_REFUSED = "/problems/invalid-options"


@dataclass(frozen=True)
class Question:
    """What is asked. photos: their folder, absolute. options: those of `POST /localize`."""

    photos: str
    map_ids: list[str]
    tag: str | None
    options: JsonObject


class PlaceFolder:
    """Reads and writes the folder. Files are replaced atomically: a kill leaves the old one or the new one."""

    def __init__(self, folder: Path, question: Question) -> None:
        self.folder = folder
        self.question = question
        self._cameras: JsonObject | None = None

    @classmethod
    @contextmanager
    def held(cls, folder: Path, question: Question) -> Iterator["PlaceFolder"]:
        """Lock and yield a folder: a new one, one with the same question, or one without results.

        The operating system holds the lock, so that a killed process leaves none. Raises typer.BadParameter.
        """
        if folder.resolve() == Path(question.photos):
            raise _wrong_out(
                "expected --out outside the folder of the photos, got that folder itself, where exports would be "
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
            if found is None or (found != asdict(question) and not (folder / "results").exists()):
                _write(folder / _QUESTION, asdict(question))
            elif found != asdict(question):
                raise _wrong_out(
                    f"expected a new folder, or one of a run with the same photos, maps and options, but {folder} is "
                    "from a different run; choose another --out"
                )
            yield cls(folder, question)

    @staticmethod
    def is_at(folder: Path) -> bool:
        """Tell whether `panoloc place` made a folder."""
        return (folder / _QUESTION).is_file()

    @classmethod
    def open(cls, folder: Path) -> "PlaceFolder":
        """Open a folder that `panoloc place` made. Raises typer.BadParameter, also if the photos are gone."""
        found = _read(folder / _QUESTION)
        if found is None:
            raise _wrong_source(f"expected the --out of a `panoloc place`, but {folder / _QUESTION} cannot be read")
        question = Question(**found)
        if not Path(question.photos).is_dir():
            raise _wrong_source(f"expected the photos in {question.photos}, but there is no such folder; put them back")
        return cls(folder, question)

    def files(self) -> PhotoFiles:
        """Return the files in the folder of the photos, without those in this folder or another of its kind."""
        return photo_files(Path(self.question.photos), self.folder, _QUESTION)

    def names(self) -> list[str]:
        """Return the photos below their folder, sorted."""
        return self.files().photos

    def gone(self) -> list[str]:
        """Return the photos that have a result but are no longer in their folder."""
        kept = (_read(file) for file in (self.folder / "results").rglob("*.json"))
        names = {str(each["name"]) for each in kept if each is not None}
        return sorted(name for name in names if not self.photo(name).exists())

    def photo(self, name: str) -> Path:
        """Return the file of a photo."""
        return Path(self.question.photos) / name

    def camera(self, name: str) -> JsonObject | None:
        """Return the camera that `cameras.json` in the folder of the photos gives a photo, an entry of `cameras`."""
        if self._cameras is None:
            self._cameras = _read(Path(self.question.photos) / CAMERAS_FILE) or {}
        found = self._cameras.get(name)
        return found if isinstance(found, dict) else None

    def result(self, name: str) -> Result | None:
        """Return the result of a photo; None if there is none, or if the file has changed since."""
        found = _read(self._result_file(name))
        return found["result"] if found is not None and found["file"] == _fingerprint(self.photo(name)) else None

    def put_result(self, name: str, result: Result) -> None:
        """Store the result of a photo."""
        _write(self._result_file(name), {"name": name, "file": _fingerprint(self.photo(name)), "result": result})

    def is_final(self, name: str) -> bool:
        """Tell whether a photo has a result that another run would not change: an answer, or a fault of the photo itself."""
        result = self.result(name)
        if result is None or result["status"] != "failed":
            return result is not None
        error = result["error"]
        return error.get("status") in _OF_THE_PHOTO and not are_options_refused(error)

    def put_map(self, place: JsonObject, points: bytes | None = None) -> None:
        """Store what exports need of a map. points: None leaves the stored ones."""
        _write(self.folder / "maps" / f"{place['id']}.json", place)
        if points is not None:
            _replace(self.folder / "maps" / f"{place['id']}.ply", points)

    def points(self, map_id: str) -> Path | None:
        """Return the file with the points of a map, None if they are not stored."""
        points = self.folder / "maps" / f"{map_id}.ply"
        return points if points.exists() else None

    def maps(self) -> list[str]:
        """Return the maps in which photos were placed."""
        return maps_of(result for name in self.names() if (result := self.result(name)) is not None)

    def tour(self, map_id: str, include_ambiguous: bool, survey: Path | None = None) -> dict[str, Any]:
        """Return the photos of a map as `panoloc.core.exports` reads them. survey: the scan itself, an E57.

        Raises typer.BadParameter if the map is not stored.
        """
        place = _read(self.folder / "maps" / f"{map_id}.json")
        if place is None:
            raise _wrong_source(f"expected {map_id} in {self.folder / 'maps'}; let `panoloc place` finish")
        tour = TourDocument(map_id, include_ambiguous)
        for name in self.names():
            result = self.result(name)
            reason = tour.why_not(result)
            if result is None or reason is not None:
                tour.leave_out(name, reason or "waiting")
            else:
                tour.add(name, self.photo(name), result["answer"])
        for name in self.gone():
            tour.leave_out(name, f"it was placed, but is no longer in {self.question.photos}")
        created_unix_s = (self.folder / _QUESTION).stat().st_mtime
        return tour.document(created_unix_s, place, self.folder / "maps" / f"{map_id}.ply", survey)

    def write_unplaced(self) -> Path:
        """Write the list of photos without a reliable pose, with the reasons."""
        lines = []
        for name in self.names():
            result = self.result(name)
            map_id = ((result or {}).get("answer") or {}).get("map_id") or ""
            reason = TourDocument(map_id, include_ambiguous=False).why_not(result)
            if reason is not None:
                lines.append(f"{shown_name(name)}\t{' '.join(reason.split())}\n")
        target = self.folder / "unplaced.txt"
        # File names that are not UTF-8 are written as they are.
        _replace(target, os.fsencode("".join(lines)))
        return target

    def _result_file(self, name: str) -> Path:
        return self.folder / "results" / f"{name}.json"


def are_options_refused(problem: JsonObject) -> bool:
    """Tell whether a problem document is about the options, not about the photo."""
    return str(problem.get("type", "")).endswith(_OPTIONS_REFUSED)


def _wrong_out(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="--out")


def _wrong_source(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="SOURCE")


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
    _replace(file, (json.dumps(document, ensure_ascii=False) + "\n").encode(errors="backslashreplace"))


def _replace(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.tmp")
    temporary.write_bytes(data)
    temporary.replace(file)
