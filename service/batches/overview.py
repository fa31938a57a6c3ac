"""Results of images as `panoloc.core.exports.overview` draws them; of batches, and of folders of the command line."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from panoloc.service.jobs import Result

_MAX_OTHERS = 4  # places of one ambiguous photo, besides the likeliest


def photo_of(name: str, result: Result | None, map_id: str | None, image: Path | None = None) -> dict[str, Any]:
    """Return a photo for `placement_document`. result: None while there is none. map_id: whose poses are drawn.

    image: its file, for pictures that show it.
    """
    answer = (result or {}).get("answer") or {}
    found: list[dict[str, Any]] = []
    if answer.get("pose") is not None:
        found = [{"map_id": answer["map_id"], "pose": answer["pose"]}]
        if answer["status"] == "ambiguous":
            found += answer["alternatives"][:_MAX_OTHERS]
    return {
        "name": name,
        "image": None if image is None else str(image),
        "status": "waiting" if result is None else result["status"],
        "confidence": answer.get("confidence"),
        "poses": [_pose(each["pose"]) for each in found if each.get("map_id") == map_id],
    }


def placement_document(map_id: str | None, scan: Path | None, photos: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Return the document of `panoloc.core.exports.overview`. map_id: the map that is drawn. scan: a PLY with its
    points."""
    return {"map": map_id or "no map", "scan": None if scan is None else str(scan), "photos": list(photos)}


def _pose(pose: dict[str, Any]) -> dict[str, Any]:
    motion = pose["map_from_camera"]
    return {
        "frame": pose["frame"],
        "position_m": [motion["position_m"][axis] for axis in "xyz"],
        "quaternion_xyzw": [motion["quaternion"][axis] for axis in "xyzw"],
    }
