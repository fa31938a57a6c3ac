"""Single answers, as `panoloc localize --out` keeps them, as what exports are written of."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.distinct_names import distinct_names
from service.batches.record import Result
from service.batches.tour import TourDocument, maps_of
from service.cli.placing.place_folder import PlaceFolderError
from service.client import JsonObject, PanolocClient
from service.jobs import MAX_SAMPLE_POINTS


@dataclass(frozen=True)
class AnsweredPhoto:
    """One image of an answer. result: as a batch has it, with the pose of this image."""

    name: str
    file: Path
    result: Result


@dataclass(frozen=True)
class SavedAnswers:
    """Answers and the maps that they are in. created_unix_s: when the last was kept. maps_folder: map_x.json and map_x.ply of each."""

    photos: tuple[AnsweredPhoto, ...]
    created_unix_s: float
    maps_folder: Path

    @classmethod
    def fetch(cls, source: Path, client: PanolocClient, maps_folder: Path) -> "SavedAnswers":
        """Read an answer, or all of a folder, and fetch what is to be known of their maps. Raises PlaceFolderError and ClientError."""
        found = [(file, answer) for file in _files(source) if (answer := _read(file)) is not None]
        pairs = [pair for file, answer in found for pair in _photos(file, answer)]
        if not pairs:
            raise PlaceFolderError(
                f"expected the --out of `panoloc place` or of `panoloc localize`, or an answer in the latter, but {source} is none; "
                "answers of older versions do not say which files they are of: localize these again"
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
        """Return the photos of a map as `core.exports` reads them. survey: the scan itself, an E57."""
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
    """Yield the images of an answer, each as if it had been asked for alone. Raises PlaceFolderError for one that is gone."""
    files = [Path(each) for each in answer["files"]]
    for number, file in enumerate(files):
        if not file.is_file():
            raise PlaceFolderError(f"expected the photo {file} of {at}, but it is no longer there; put it back")
        of_image = answer if len(files) == 1 else _of_image(answer, number)
        yield file, {"status": answer["status"], "answer": of_image}


def _of_image(answer: JsonObject, number: int) -> JsonObject:
    image = answer["images"][number]
    return {**answer, "pose": image["pose"], "images": [image]}
