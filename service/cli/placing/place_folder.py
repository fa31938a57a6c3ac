"""The folder that `panoloc place` works in: what was asked, and the result of each photo as soon as it is there.

place.json              what was asked; another question needs another folder
results/a.jpg.json      the result of FOLDER/a.jpg
maps/map_x.json, .ply   the maps with photos in them, and their points, so that exports need no service
unplaced.txt            the photos without a pose, with the reason
plan.png, contact-sheet.jpg   where the photos stand in the scan, and what became of each
"""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from core.options import CAMERAS_FILE
from core.shown_name import shown_name
from service.batches.record import Result
from service.batches.tour import TourDocument, maps_of
from service.cli.placing.photo_files import PhotoFiles, photo_files
from service.client import JsonObject

_QUESTION = "place.json"
_LOCK = ".lock"
_OF_THE_PHOTO = (413, 415, 422)
_OPTIONS_REFUSED = "/problems/invalid-options"


class PlaceFolderError(ValueError):
    """The folder is of another question, or of none; the message says what to do."""


@dataclass(frozen=True)
class Question:
    """What was asked. photos: the folder of the photos, absolute. options: those of `POST /localize`."""

    photos: str
    map_ids: list[str]
    tag: str | None
    options: JsonObject


class PlaceFolder:
    """Reads and writes the folder; every file is replaced in one step, so that a kill leaves the old one or the new one."""

    def __init__(self, folder: Path, question: Question) -> None:
        self.folder = folder
        self.question = question
        self._cameras: JsonObject | None = None

    @classmethod
    @contextmanager
    def held(cls, folder: Path, question: Question) -> Iterator["PlaceFolder"]:
        """Make a folder, or go on with one in which the same was asked or nothing came out; nobody else works in it meanwhile.

        Raises PlaceFolderError. The lock is the system's, so that a process that was killed holds none.
        """
        if folder.resolve() == Path(question.photos):
            raise PlaceFolderError(
                f"expected another folder than that of the photos, or exports would be taken for photos; try {folder / 'placed'}"
            )
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _LOCK).open("ab") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise PlaceFolderError(
                    f"expected a folder in which nobody works, but another `panoloc place` does in {folder}; wait until it has ended, or "
                    "choose another --out"
                ) from error
            found = _read(folder / _QUESTION)
            if found is None or (found != asdict(question) and not (folder / "results").exists()):
                _write(folder / _QUESTION, asdict(question))
            elif found != asdict(question):
                raise PlaceFolderError(
                    f"expected a new folder, or one with the same question, but {folder} has another; choose another --out"
                )
            yield cls(folder, question)

    @staticmethod
    def is_at(folder: Path) -> bool:
        """Tell whether `panoloc place` has made a folder."""
        return (folder / _QUESTION).is_file()

    @classmethod
    def open(cls, folder: Path) -> "PlaceFolder":
        """Open a folder that `panoloc place` has made. Raises PlaceFolderError, also where the photos are gone."""
        found = _read(folder / _QUESTION)
        if found is None:
            raise PlaceFolderError(f"expected the --out of a `panoloc place`, but {folder} has no {_QUESTION}")
        question = Question(**found)
        if not Path(question.photos).is_dir():
            raise PlaceFolderError(
                f"expected the photos in {question.photos}, but there is no such folder; put them back"
            )
        return cls(folder, question)

    def files(self) -> PhotoFiles:
        """Return what lies in the folder of the photos, without what lies in this folder or one like it."""
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
        """Return the camera of a photo, as `cameras` of a query have it, where the folder of the photos says it in `cameras.json`."""
        if self._cameras is None:
            self._cameras = _read(Path(self.question.photos) / CAMERAS_FILE) or {}
        found = self._cameras.get(name)
        return found if isinstance(found, dict) else None

    def result(self, name: str) -> Result | None:
        """Return the result of a photo, None when there is none, or the file has changed since."""
        found = _read(self._result_file(name))
        return found["result"] if found is not None and found["file"] == _fingerprint(self.photo(name)) else None

    def put_result(self, name: str, result: Result) -> None:
        """Keep the result of a photo."""
        _write(self._result_file(name), {"name": name, "file": _fingerprint(self.photo(name)), "result": result})

    def is_final(self, name: str) -> bool:
        """Tell whether a photo has a result that no other run could change: one, or a failure of the photo itself."""
        result = self.result(name)
        if result is None or result["status"] != "failed":
            return result is not None
        error = result["error"]
        return error.get("status") in _OF_THE_PHOTO and not are_options_refused(error)

    def put_map(self, place: JsonObject, points: bytes | None = None) -> None:
        """Keep what exports need of a map. points: None for those that are here already."""
        _write(self.folder / "maps" / f"{place['id']}.json", place)
        if points is None:
            return
        _replace(self.folder / "maps" / f"{place['id']}.ply", points)

    def points(self, map_id: str) -> Path | None:
        """Return the file with the points of a map, None where they were not kept."""
        points = self.folder / "maps" / f"{map_id}.ply"
        return points if points.exists() else None

    def maps(self) -> list[str]:
        """Return the maps in which photos were placed."""
        return maps_of(result for name in self.names() if (result := self.result(name)) is not None)

    def tour(self, map_id: str, include_ambiguous: bool, survey: Path | None = None) -> dict[str, Any]:
        """Return the photos of a map as `core.exports` reads them. survey: the scan itself, an E57.

        Raises PlaceFolderError where the map was not kept."""
        place = _read(self.folder / "maps" / f"{map_id}.json")
        if place is None:
            raise PlaceFolderError(
                f"expected what is known of {map_id} in {self.folder / 'maps'}; run `panoloc place` to its end"
            )
        tour = TourDocument(map_id, include_ambiguous)
        for name in self.names():
            result = self.result(name)
            reason = tour.why_not(result)
            if result is None or reason is not None:
                tour.leave_out(name, reason or "waiting")
            else:
                tour.add(name, self.photo(name), result["answer"])
        for name in self.gone():
            tour.leave_out(name, f"was placed, but is no longer in {self.question.photos}")
        created_unix_s = (self.folder / _QUESTION).stat().st_mtime
        points = self.folder / "maps" / f"{map_id}.ply"
        return tour.document(created_unix_s, place, points, survey)

    def write_unplaced(self) -> Path:
        """Write the list of photos without a pose that can be relied on."""
        lines = []
        for name in self.names():
            result = self.result(name)
            map_id = ((result or {}).get("answer") or {}).get("map_id") or ""
            reason = TourDocument(map_id, include_ambiguous=False).why_not(result)
            if reason is not None:
                lines.append(f"{shown_name(name)}\t{' '.join(reason.split())}\n")
        target = self.folder / "unplaced.txt"
        # A name that is no UTF-8 stands there as it is.
        _replace(target, os.fsencode("".join(lines)))
        return target

    def _result_file(self, name: str) -> Path:
        return self.folder / "results" / f"{name}.json"


def are_options_refused(problem: JsonObject) -> bool:
    """Tell whether a problem document is about what was asked, not about the photo."""
    return str(problem.get("type", "")).endswith(_OPTIONS_REFUSED)


def _fingerprint(photo: Path) -> list[int]:
    """Return what changes with a file; nothing of one that is not there, such as a link to nowhere."""
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
    # In JSON, too, a backslash is how to write what UTF-8 cannot hold: names that are no UTF-8.
    _replace(file, (json.dumps(document, ensure_ascii=False) + "\n").encode(errors="backslashreplace"))


def _replace(file: Path, data: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.tmp")
    temporary.write_bytes(data)
    temporary.replace(file)
