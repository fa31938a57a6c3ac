"""Results of images as the tour that `panoloc.core.exports` reads; of batches, and of folders of the command line."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoloc.core.options import FORMATS_ON_EARTH, ExportFormat
from panoloc.service.jobs import ON_EARTH, Result

WALK_PAGE = Path(__file__).parents[1] / "console" / "built" / "walk"
"""The page of the walk-through, built with the console."""
_MAX_OTHERS = 4  # places of one ambiguous photo, besides the likeliest


@dataclass(frozen=True)
class Photo:
    """A photo. image: its file, None where nothing shows it. result: None while there is none."""

    name: str
    image: Path | None
    result: Result | None


def why_left_out(result: Result | None, map_id: str | None, include_ambiguous: bool) -> str | None:
    """Return why a photo is not exported, None when it is.

    map_id: whose photos are exported; None: of all maps. include_ambiguous: also photos that show what looks the same from several places.
    """
    if result is None:
        return "waiting"
    if result["status"] == "failed":
        return f"failed: {result['error'].get('detail') or result['error'].get('title')}"
    answer = result["answer"]
    guess = f", its best guess with a confidence of {answer['confidence']:.2f}" if answer["confidence"] else ""
    if answer["pose"] is None:
        return f"not_localized: no place fits well enough{guess}"
    if result["status"] == "ambiguous" and not include_ambiguous:
        return f"ambiguous: several places look the same{guess}; include ambiguous photos to export it"
    is_elsewhere = map_id is not None and answer["map_id"] != map_id
    return f"placed in another map, {answer['map_id']}" if is_elsewhere else None


def lacks_place(name: ExportFormat, place: Mapping[str, Any]) -> bool:
    """Tell whether a format holds places on Earth and a map has none. place: its document, or that of its tour."""
    return name in FORMATS_ON_EARTH and not (place.get("georeference") or place.get("coordinate_system"))


def maps_of(results: Iterable[Result | None]) -> list[str]:
    """Return the maps in which photos were placed, each once, sorted."""
    answers = (result.get("answer") for result in results if result is not None)
    return sorted({answer["map_id"] for answer in answers if answer is not None and answer["pose"] is not None})


def tour_document(
    map_id: str,
    include_ambiguous: bool,
    photos: Iterable[Photo],
    created_unix_s: float,
    place: Mapping[str, Any],
    scan: Path | None,
    survey: Path | None,
    gone: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the tour of one map for `panoloc.core.exports`.

    place: document of the map, of which name, floors and the place on Earth are used. scan: a PLY with the points of the map. survey:
    the scan itself, an E57. gone: further names that are left out, each with the reason.
    """
    placed, left_out = [], dict[str, str]()
    stats = place.get("stats") or {}
    for photo in photos:
        reason = why_left_out(photo.result, map_id, include_ambiguous)
        if photo.result is None or reason is not None:
            left_out[photo.name] = reason or "waiting"
        else:
            placed.append(_placed(photo, photo.result["answer"]))
    reasons = [(name, " ".join(reason.split())) for name, reason in (left_out | dict(gone or {})).items()]
    return {
        "name": map_id,
        "created_unix_s": created_unix_s,
        **{name: place.get(name) for name in ON_EARTH},
        "scan": None if scan is None else str(scan),
        "survey": None if survey is None else str(survey),
        "floor_levels_m": [floor["level_m"] for floor in stats.get("floors") or ()],
        "title": place.get("name") or map_id,
        "page": str(WALK_PAGE),
        "photos": placed,
        "left_out": [{"name": name, "reason": reason} for name, reason in reasons],
    }


def overview_document(map_id: str | None, scan: Path | None, photos: Iterable[Photo]) -> dict[str, Any]:
    """Return the document of `panoloc.core.exports.overview`. map_id: the map that is drawn. scan: a PLY with its
    points."""
    shown = [_shown(photo, map_id) for photo in photos]
    return {"map": map_id or "no map", "scan": None if scan is None else str(scan), "photos": shown}


def _placed(photo: Photo, answer: Mapping[str, Any]) -> dict[str, Any]:
    accuracy = answer["accuracy"] or {}
    return {
        "name": photo.name,
        "image": str(photo.image),
        **_pose(answer["pose"]),
        "camera_model": answer["images"][0]["camera"]["model"],
        "hfov_deg": answer["images"][0]["camera"]["hfov_deg"],
        "confidence": answer["confidence"],
        "position_radius_m": accuracy.get("position_m"),
        "orientation_radius_deg": accuracy.get("orientation_deg"),
        "is_by_hand": answer.get("placed_by") == "hand",
    }


def _shown(photo: Photo, map_id: str | None) -> dict[str, Any]:
    answer = (photo.result or {}).get("answer") or {}
    found: list[Mapping[str, Any]] = [answer] if answer.get("pose") is not None else []
    if found and answer["status"] == "ambiguous":
        found += answer["alternatives"][:_MAX_OTHERS]
    return {
        "name": photo.name,
        "image": None if photo.image is None else str(photo.image),
        "status": "waiting" if photo.result is None else photo.result["status"],
        "confidence": answer.get("confidence"),
        "poses": [_pose(each["pose"]) for each in found if each.get("map_id") == map_id],
    }


def _pose(pose: Mapping[str, Any]) -> dict[str, Any]:
    motion = pose["map_from_camera"]
    return {
        "frame": pose["frame"],
        "position_m": [motion["position_m"][axis] for axis in "xyz"],
        "quaternion_xyzw": [motion["quaternion"][axis] for axis in "xyzw"],
    }
