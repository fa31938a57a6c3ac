"""Results of many photos as JSON: the input of the process that draws overviews.

{"map": "map_…", "scan": null | "points.ply",
 "photos": [{"name": "a.jpg", "image": null | "/…/a.jpg", "status": "localized|ambiguous|not_localized|failed|waiting", "confidence": 0.9,
             "poses": [{"frame": "ros", "position_m": [x, y, z], "quaternion_xyzw": [x, y, z, w]}]}]}
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from panoloc.core.geometry.pose import Pose

PhotoStatus = Literal["localized", "ambiguous", "not_localized", "failed", "waiting"]


@dataclass(frozen=True)
class PhotoSeen:
    """A photo and its result. number: from 1, the same in all pictures.

    poses: `map_from_camera` in the map that is drawn: one of a `localized` photo; of an `ambiguous` one the likeliest,
    then the others. image: its file, or None.
    """

    number: int
    name: str
    status: PhotoStatus
    confidence: float | None
    poses: tuple[Pose, ...]
    image: Path | None


@dataclass(frozen=True)
class Placement:
    """All photos, in order. map_name: the map that is drawn. scan: a PLY with its points, or None."""

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
