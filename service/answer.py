"""The answer to a query as the HTTP contract promises it. No other module knows its shape."""

from collections.abc import Iterable
from typing import Any

from core.options import Frame
from service.jobs import ARTIFACTS, FoundImage, FoundPose, LocalizeOutcome, RigidMotion

Document = dict[str, Any]

_ACCURACY_LEVEL = 0.68


def answer_document(
    localization_id: str, outcome: LocalizeOutcome, frame: Frame, *, total_s: float, warnings: Iterable[str] = ()
) -> Document:
    """Return the 200 body of `POST /localize`.

    frame: that the query asked for. total_s: seconds that the caller waited; `queue` is what the worker did not need of them.
    warnings: of the HTTP side, after those of the search. A query that fits no pose has `pose: null`, and so have its
    images; the best guess then leads the alternatives.
    """
    best, motion = outcome.best, outcome.map_from_session
    answer = None if outcome.status == "not_localized" else best
    others = outcome.alternatives if answer is best or best is None else (best, *outcome.alternatives)
    return {
        "id": localization_id,
        "status": outcome.status,
        "map_id": answer and answer.map.id,
        "map_revision": answer and answer.map.revision,
        "pose": answer and _pose(answer, frame),
        "map_from_session": None if answer is None or motion is None else _motion(motion),
        "images": [_image(each, frame, known=answer is not None) for each in outcome.images],
        "geopose": None,
        "confidence": best.confidence if best else 0.0,
        "accuracy": answer and {
            "position_m": outcome.accuracy_position_m,
            "orientation_deg": outcome.accuracy_orientation_deg,
            "level": _ACCURACY_LEVEL,
        },
        "alternatives": [
            {"pose": _pose(each, frame), "confidence": each.confidence, "map_id": each.map.id} for each in others
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


def _pose(found: FoundPose, frame: Frame) -> Document:
    return {
        "frame": frame,
        "map_from_camera": _motion(found),
        "yaw_deg": found.yaw_deg,
        "pitch_deg": found.pitch_deg,
        "roll_deg": found.roll_deg,
    }


def _motion(found: FoundPose | RigidMotion) -> Document:
    return {
        "position_m": dict(zip("xyz", found.position_m, strict=True)),
        "quaternion": dict(zip("xyzw", found.quaternion_xyzw, strict=True)),
        "matrix": found.matrix,
    }


def _image(found: FoundImage, frame: Frame, *, known: bool) -> Document:
    return {
        "pose": _pose(found.pose, frame) if known and found.pose is not None else None,
        "agreement": found.agreement,
        "camera": {"model": found.model, "hfov_deg": found.hfov_deg},
    }


def _timings(of_worker: dict[str, float], total_s: float) -> dict[str, float]:
    stages = {name: seconds for name, seconds in of_worker.items() if name != "total"}
    waited_s = max(0.0, total_s - of_worker.get("total", sum(stages.values())))
    return {"queue": round(waited_s, 6), **stages, "total": round(total_s, 6)}
