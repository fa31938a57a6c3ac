"""The answer to a query as the HTTP contract promises it. No other module knows its shape."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from core.geopose import MapPose, geopose_of
from core.georeference import coordinate_system
from core.options import Frame
from service.jobs import ARTIFACTS, FoundImage, FoundPose, LocalizeOutcome, RigidMotion

Document = dict[str, Any]

_ACCURACY_LEVEL = 0.68


def answer_document(
    localization_id: str,
    outcome: LocalizeOutcome,
    frame: Frame,
    *,
    total_s: float,
    warnings: Iterable[str] = (),
    georeferences: Mapping[str, Document] | None = None,
) -> Document:
    """Return the 200 body of `POST /localize`.

    frame: that the query asked for. total_s: seconds that the caller waited; `queue` is what the worker did not need of them.
    warnings: of the HTTP side, after those of the search. georeferences: by map id, of the maps that have one.
    A query that fits no pose has `pose: null`, and so have its images; the best guess then leads the alternatives.
    """
    known = georeferences or {}
    best, motion = outcome.best, outcome.map_from_session
    answer = None if outcome.status == "not_localized" else best
    others = outcome.alternatives if answer is best or best is None else (best, *outcome.alternatives)
    return {
        "id": localization_id,
        "status": outcome.status,
        "map_id": answer and answer.map.id,
        "map_revision": answer and answer.map.revision,
        "pose": answer and _pose(answer, frame, known.get(answer.map.id)),
        "map_from_session": None if answer is None or motion is None else _motion(motion),
        "images": [_image(each if answer else replace(each, pose=None), frame, known) for each in outcome.images],
        "geopose": answer and _geopose(answer, frame, known.get(answer.map.id)),
        "confidence": best.confidence if best else 0.0,
        "accuracy": answer and {
            "position_m": outcome.accuracy_position_m,
            "orientation_deg": outcome.accuracy_orientation_deg,
            "level": _ACCURACY_LEVEL,
        },
        "alternatives": [
            {
                "pose": _pose(each, frame, known.get(each.map.id)),
                "confidence": each.confidence,
                "map_id": each.map.id,
            }
            for each in others
        ],
        "change": {
            "panorama_changed_fraction": outcome.panorama_changed_fraction,
            "map_changed_fraction": outcome.map_changed_fraction,
        },
        "timings_s": _timings(outcome.timings_s, total_s),
        "search": outcome.search,
        "warnings": [*outcome.warnings, *warnings],
        "artifacts": {name: picture_path(localization_id, name) for name in ARTIFACTS if name in outcome.pictures},
    }  # fmt: skip


def picture_path(localization_id: str, name: str) -> str:
    """Return the path of one PNG of an answer."""
    return f"/localizations/{localization_id}/{name.replace('_', '-')}.png"


def without_copies(answer: Document) -> Document:
    """Return an answer of which Redis has no copy: it cannot be fetched again, and its pictures cannot be fetched at all."""
    said = (
        "Redis cannot keep this answer: it cannot be fetched again, and its pictures are lost; localize again for them"
    )
    return {**answer, "artifacts": {}, "warnings": [*answer["warnings"], said]}


def _pose(found: FoundPose, frame: Frame, georeference: Document | None) -> Document:
    """Return a pose with its angles twice: as rotations about its axes, and as photographers mean them.

    georeference: of the map; it turns the heading from the map's y axis to true north.
    """
    north_deg = _north_deg(found, frame, georeference)
    return {
        "frame": frame,
        "map_from_camera": _motion(found),
        "yaw_deg": found.yaw_deg,
        "pitch_deg": found.pitch_deg,
        "roll_deg": found.roll_deg,
        "heading_deg": round((90.0 - found.yaw_deg + (north_deg or 0.0)) % 360.0, 9) % 360.0,
        "elevation_deg": 0.0 - found.pitch_deg,
        "camera_roll_deg": found.roll_deg,
        "north": "map" if north_deg is None else "true",
    }


def _geopose(found: FoundPose, frame: Frame, georeference: Document | None) -> Document | None:
    """Return where a pose is on Earth; None where the map, or the height above the ellipsoid, is not known to be anywhere."""
    if georeference is None:
        return None
    position_m = in_map_axes(found.position_m, frame)
    return geopose_of(georeference, MapPose(position_m, found.yaw_deg, found.pitch_deg, found.roll_deg))


def _north_deg(found: FoundPose, frame: Frame, georeference: Document | None) -> float | None:
    """Return the compass heading of the map's y axis at a pose, clockwise from true north; None where that is not known."""
    if georeference is None:
        return None
    if "coordinate_system" not in georeference:
        return float(georeference["heading_deg"])
    place = coordinate_system(georeference["coordinate_system"]).place(in_map_axes(found.position_m, frame))
    return None if place is None else place.convergence_deg


def in_map_axes(position_m: list[float], frame: Frame) -> tuple[float, float, float]:
    """Return a position with z up; webxr has (x, z, −y) of the map, unity (x, z, y)."""
    first, second, third = position_m
    return {"webxr": (first, -third, second), "unity": (first, third, second)}.get(frame, (first, second, third))


def _motion(found: FoundPose | RigidMotion) -> Document:
    return {
        "position_m": dict(zip("xyz", found.position_m, strict=True)),
        "quaternion": dict(zip("xyzw", found.quaternion_xyzw, strict=True)),
        "matrix": found.matrix,
    }


def _image(found: FoundImage, frame: Frame, georeferences: Mapping[str, Document]) -> Document:
    pose = found.pose
    return {
        "pose": pose and _pose(pose, frame, georeferences.get(pose.map.id)),
        "agreement": found.agreement,
        "camera": {"model": found.model, "hfov_deg": found.hfov_deg},
    }


def _timings(of_worker: dict[str, float], total_s: float) -> dict[str, float]:
    stages = {name: seconds for name, seconds in of_worker.items() if name != "total"}
    waited_s = max(0.0, total_s - of_worker.get("total", sum(stages.values())))
    return {"queue": round(waited_s, 6), **stages, "total": round(total_s, 6)}
