"""From what `core` found to the body that the HTTP contract promises."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from core.geometry.pose import Pose
from core.options import Frame
from core.results import Candidate, Localization
from service.jobs import MapRef

Body = dict[str, Any]


def localization_body(
    localization: Localization, maps: Sequence[MapRef], frame: Frame, timings_s: Mapping[str, float]
) -> Body:
    """Return the 200 body of `POST /localize` without id, links to pictures and the HTTP side's timings.

    maps: in the order that `Candidate.map_position` counts. timings_s: seconds measured around the search, added to
    its own. A panorama that fits no pose has `pose: null`; the best guess then leads the alternatives.
    """
    best = localization.best
    is_answer = best is not None and localization.status != "not_localized"
    others = [*localization.alternatives] if is_answer or best is None else [best, *localization.alternatives]
    found_in = maps[best.map_position] if best is not None and is_answer else None
    body = {
        "status": localization.status,
        "map_id": found_in.id if found_in else None,
        "map_revision": found_in.revision if found_in else None,
        "pose": pose_body(best.pose, frame) if best is not None and is_answer else None,
        "geopose": None,
        "confidence": best.confidence if best is not None else 0.0,
        "accuracy": _accuracy_body(localization) if is_answer else None,
        "alternatives": [_alternative_body(candidate, maps, frame) for candidate in others],
        "change": {
            "panorama_changed_fraction": localization.panorama_changed_fraction,
            "map_changed_fraction": localization.map_changed_fraction,
        },
        "timings_s": {**timings_s, **localization.timings_s},
        "search": _search_body(localization),
        "warnings": list(localization.warnings),
    }
    safe: Body = json_safe(body)
    return safe


def pose_body(pose: Pose, frame: Frame) -> Body:
    """Return a pose in `frame`; yaw, pitch and roll are always those of the map's own frame (z up)."""
    turned = pose.in_frame(frame)
    yaw, pitch, roll = (math.degrees(angle) for angle in pose.yaw_pitch_roll)
    return {
        "frame": frame,
        "map_from_camera": {
            "position_m": dict(zip("xyz", turned.position.tolist(), strict=True)),
            "quaternion": dict(zip("xyzw", turned.quaternion_xyzw.tolist(), strict=True)),
            "matrix": turned.matrix.tolist(),
        },
        "yaw_deg": yaw,
        "pitch_deg": pitch,
        "roll_deg": roll,
    }


def json_safe(value: Any) -> Any:
    """Return `value` with numpy scalars and arrays as plain ones, and NaN or infinity, which JSON has not, as None."""
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return json_safe(value.tolist())
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, np.generic):
        return json_safe(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _accuracy_body(localization: Localization) -> Body:
    return {
        "position_m": localization.accuracy_position_m,
        "orientation_deg": localization.accuracy_orientation_deg,
        "level": 0.68,
    }


def _alternative_body(candidate: Candidate, maps: Sequence[MapRef], frame: Frame) -> Body:
    return {
        "pose": pose_body(candidate.pose, frame),
        "confidence": candidate.confidence,
        "map_id": maps[candidate.map_position].id,
    }


def _search_body(localization: Localization) -> Body:
    best, evidence = localization.best, localization.evidence
    body = asdict(localization.search)
    if best is not None:
        body |= {"color_model": best.color_model, "sampling_loss": best.sampling_loss, "score": best.score}
        body |= {"iterations": best.num_iterations, "num_iterations": best.num_iterations}
    return body if evidence is None else body | asdict(evidence)
