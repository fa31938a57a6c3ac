"""Place photos with known poses by `panoloc place`, kill it in the middle with SIGKILL, run it again, and say what came of it.

    python -m lab.placing.killed_run CASES/house --flats 1000-1004 --photos-of-flat 3 --one-by-one

Starts a service of its own, registers the scan of each place, all under one tag, and lets the photos be searched in all of them. Prints
JSON; ends with 1 where a photo was localized twice, a localized one is wrong, or one that is right alone is not.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from core.geometry.pose import Pose, pose_error
from lab.evaluation.sources.suite_source import seed_range
from lab.own_service import OwnService, own_service
from lab.placing.known_photos import KnownPhoto, KnownPhotos, known_photos
from service.client import JsonObject

TAG = "tour"
_WITHIN_M, _WITHIN_DEG = 0.3, 10.0
_POLL_S = 0.05


@dataclass(frozen=True)
class PlacedTour:
    """What became of a folder. seconds: of both runs without their start. done_when_killed: results that were there.

    done_again: of these, how many the second run wrote anew. right: localized, in its own place, within 0.3 m and 10 degrees. wrong:
    localized and not right. right_alone: localized rightly when it was sent alone, to its own map; None where that was not tried.
    lost: names of those that were right alone and are not among the others.
    """

    photos: int
    maps: int
    done_when_killed: int
    done_again: int
    statuses: dict[str, int]
    right: int
    wrong: int
    median_error_m: float
    median_error_deg: float
    seconds: float
    seconds_per_photo: float
    right_alone: int | None
    lost: list[str]

    @property
    def is_as_promised(self) -> bool:
        """Tell whether nothing was done twice, nothing wrong was called localized and nothing was lost."""
        return self.done_again == 0 and self.wrong == 0 and not self.lost


def place_and_kill(known: KnownPhotos, service: OwnService, out: Path, kill_after: int, one_by_one: bool) -> PlacedTour:
    """Place the photos into the maps of their scans. kill_after: results."""
    maps = {place: _registered(service, place, scan) for place, scan in known.scans.items()}
    began = time.monotonic()
    with _placing(known, service, out) as process:
        while process.poll() is None and len(_results(out)) < kill_after:
            time.sleep(_POLL_S)
        process.send_signal(signal.SIGKILL)
    at_kill = {path: path.stat().st_mtime_ns for path in _results(out)}
    with _placing(known, service, out) as process:
        process.wait()
    seconds = time.monotonic() - began
    answers = {photo.name: _result(out, photo.name) for photo in known.photos}
    errors = [error_of(photo, maps, answers[photo.name].get("answer")) for photo in known.photos]
    right = {photo.name for photo, error in zip(known.photos, errors, strict=True) if _is_right(error)}
    statuses = Counter(str(found["status"]) for found in answers.values())
    alone = _right_alone(known, service, maps) if one_by_one else None
    near = [error for error in errors if error is not None and _is_right(error)]
    return PlacedTour(
        photos=len(known.photos),
        maps=len(maps),
        done_when_killed=len(at_kill),
        done_again=sum(path.stat().st_mtime_ns != written for path, written in at_kill.items()),
        statuses=dict(statuses),
        right=len(right),
        wrong=statuses["localized"] - len(right),
        median_error_m=round(float(np.median([metres for metres, _ in near])), 4),
        median_error_deg=round(float(np.median([degrees for _, degrees in near])), 3),
        seconds=round(seconds, 1),
        seconds_per_photo=round(seconds / len(known.photos), 2),
        right_alone=None if alone is None else len(alone),
        lost=sorted((alone or set()) - right),
    )


def _registered(service: OwnService, place: str, scan: Path) -> str:
    options = {"name": place, "tags": [TAG]}
    return str(service.client.wait_for_map(service.client.register_map(scan, options)["id"])["id"])


@contextmanager
def _placing(known: KnownPhotos, service: OwnService, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "service.cli", "place", str(known.folder), "--tag", TAG]
    command += ["--out", str(out), "--url", service.url]
    with (service.folder / "place.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def _results(out: Path) -> list[Path]:
    return [path for path in (out / "results").rglob("*.json") if not path.name.startswith(".")]


def _result(out: Path, name: str) -> JsonObject:
    return dict(json.loads((out / "results" / f"{name}.json").read_text(encoding="utf-8"))["result"])


def error_of(photo: KnownPhoto, maps: dict[str, str], answer: JsonObject | None) -> tuple[float, float] | None:
    """Return metres and degrees of a localized answer, both infinite in another map; None of one that is not localized."""
    if answer is None or answer["status"] != "localized":
        return None
    if answer["map_id"] != maps[photo.place]:
        return np.inf, np.inf
    matrix = np.asarray(answer["pose"]["map_from_camera"]["matrix"])
    error = pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), photo.pose)
    return error.position_m, error.orientation_deg


def _is_right(error: tuple[float, float] | None) -> bool:
    return error is not None and error[0] <= _WITHIN_M and error[1] <= _WITHIN_DEG


def _right_alone(known: KnownPhotos, service: OwnService, maps: dict[str, str]) -> set[str]:
    return {
        photo.name
        for photo in known.photos
        if _is_right(
            error_of(photo, maps, service.client.localize(known.folder / photo.name, map_ids=[maps[photo.place]]))
        )
    }


def main(arguments: list[str]) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="Place photos with known poses, with a kill in the middle.")
    parser.add_argument("cases", nargs="*", type=Path, help="folders with a truth.json")
    parser.add_argument("--flats", default="", help="seeds of made-up flats, such as 1000-1004")
    parser.add_argument("--photos-of-flat", type=int, default=3)
    parser.add_argument("--limit", type=int, help="photos of each place")
    parser.add_argument("--kill-after", type=int, help="results; half of the photos")
    parser.add_argument("--one-by-one", action="store_true", help="also send each photo alone to its own map")
    given = parser.parse_args(arguments)
    seeds = seed_range(given.flats) if given.flats else []
    with tempfile.TemporaryDirectory(prefix="panoloc-tour-") as folder, own_service() as service:
        known = known_photos(Path(folder), given.cases, seeds, given.photos_of_flat, given.limit)
        kill_after = len(known.photos) // 2 if given.kill_after is None else given.kill_after
        tour = place_and_kill(known, service, Path(folder) / "placed", kill_after, given.one_by_one)
    print(json.dumps(asdict(tour)))
    return 0 if tour.is_as_promised else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
