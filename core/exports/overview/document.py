"""What became of many photos, as JSON: what the process that draws overviews is given.

{"map": "map_…", "scan": null | "points.ply",
 "photos": [{"name": "a.jpg", "image": null | "/…/a.jpg", "status": "localized|ambiguous|not_localized|failed|waiting", "confidence": 0.9,
             "poses": [{"frame": "ros", "position_m": [x, y, z], "quaternion_xyzw": [x, y, z, w]}]}]}
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from core.geometry.pose import Pose

PhotoStatus = Literal["localized", "ambiguous", "not_localized", "failed", "waiting"]


@dataclass(frozen=True)
class PhotoSeen:
    """A photo and what became of it. number: from 1, the same in all pictures.

    poses: `map_from_camera` in the map that is drawn: one where the photo is `localized` there, of an `ambiguous` one the likeliest and
    the others that fit. image: its file, None where that is not there.
    """

    number: int
    name: str
    status: PhotoStatus
    confidence: float | None
    poses: tuple[Pose, ...]
    image: Path | None


@dataclass(frozen=True)
class Placement:
    """All photos, in their order. map_name: the map that is drawn. scan: a PLY with its points, None where there is none."""

    map_name: str
    photos: tuple[PhotoSeen, ...]
    scan: Path | None


def read_placement(path: Path) -> Placement:
    """Return what a file describes."""
    document = json.loads(path.read_text(encoding="utf-8"))
    scan = document["scan"]
    photos = tuple(_photo(number, each) for number, each in enumerate(document["photos"], 1))
    return Placement(document["map"], photos, None if scan is None else Path(scan))


def _photo(number: int, given: dict[str, Any]) -> PhotoSeen:
    poses = tuple(
        Pose.from_frame(each["position_m"], each["quaternion_xyzw"], each["frame"]) for each in given["poses"]
    )
    image = None if given["image"] is None else Path(given["image"])
    return PhotoSeen(number, given["name"], given["status"], given["confidence"], poses, image)
