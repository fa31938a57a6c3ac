"""Answers that `panoloc localize --out` saved, as a source of exports."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from panoloc.core.distinct_names import distinct_names
from panoloc.service.batches.tour import TourDocument, maps_of
from panoloc.service.client import JsonObject, PanolocClient
from panoloc.service.jobs import MAX_SAMPLE_POINTS, Result


@dataclass(frozen=True)
class AnsweredPhoto:
    """One image of an answer. result: in the form of a batch, with the pose of this image."""

    name: str
    file: Path
    result: Result


@dataclass(frozen=True)
class SavedAnswers:
    """Answers and their maps. created_unix_s: when the last was saved. maps_folder: has map_x.json and map_x.ply of each."""

    photos: tuple[AnsweredPhoto, ...]
    created_unix_s: float
    maps_folder: Path

    @classmethod
    def fetch(cls, source: Path, client: PanolocClient, maps_folder: Path) -> "SavedAnswers":
        """Read an answer, or all in a folder, and fetch their maps. Raises typer.BadParameter and ClientError."""
        found = [(file, answer) for file in _files(source) if (answer := _read(file)) is not None]
        pairs = [pair for file, answer in found for pair in _photos(file, answer)]
        if not pairs:
            raise _wrong_source(
                "expected the --out of `panoloc place` or `panoloc localize`, or an answer in the latter, "
                f"but {source} is none of these"
            )
        names = distinct_names(file.name for file, _ in pairs)
        photos = tuple(AnsweredPhoto(name, *pair) for name, pair in zip(names, pairs, strict=True))
        answers = cls(photos, max(file.stat().st_mtime for file, _ in found), maps_folder)
        for map_id in answers.maps():
            points = client.fetch(f"/maps/{map_id}/points?format=ply&max_points={MAX_SAMPLE_POINTS}")
            (maps_folder / f"{map_id}.ply").write_bytes(points)
            (maps_folder / f"{map_id}.json").write_text(json.dumps(client.get_map(map_id)), encoding="utf-8")
        return answers

    def maps(self) -> list[str]:
        """Return the maps in which photos were placed."""
        return maps_of(photo.result for photo in self.photos)

    def tour(self, map_id: str, include_ambiguous: bool, survey: Path | None = None) -> dict[str, Any]:
        """Return the photos of a map as `panoloc.core.exports` reads them. survey: the scan itself, an E57."""
        tour = TourDocument(map_id, include_ambiguous)
        for photo in self.photos:
            reason = tour.why_not(photo.result)
            if reason is None:
                tour.add(photo.name, photo.file, photo.result["answer"])
            else:
                tour.leave_out(photo.name, reason)
        place = json.loads((self.maps_folder / f"{map_id}.json").read_text(encoding="utf-8"))
        return tour.document(self.created_unix_s, place, self.maps_folder / f"{map_id}.ply", survey)


def _files(source: Path) -> list[Path]:
    return sorted(source.glob("*.json")) if source.is_dir() else [source]


def _read(file: Path) -> JsonObject | None:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "files" in found and "status" in found else None


def _photos(at: Path, answer: JsonObject) -> Iterator[tuple[Path, Result]]:
    """Yield the images of an answer, each as if it were a query of its own. Raises typer.BadParameter if one is gone."""
    files = [Path(each) for each in answer["files"]]
    for number, file in enumerate(files):
        if not file.is_file():
            raise _wrong_source(f"expected the photo {file} of {at}, but it is no longer there; put it back")
        of_image = answer
        if len(files) > 1:
            image = answer["images"][number]
            of_image = {**answer, "pose": image["pose"], "images": [image]}
        yield file, {"status": answer["status"], "answer": of_image}


def _wrong_source(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="SOURCE")
