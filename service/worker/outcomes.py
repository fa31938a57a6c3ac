"""From what `core` found to the outcomes that travel to the HTTP process: plain values that survive JSON, without numpy."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from core.geometry.pose import Pose
from core.index.map_index import MapIndex
from core.options import Frame
from core.panorama.session import Photo, Session
from core.results import Candidate, Localization
from core.scan.ply.writer import encode_ply
from core.scan.point_cloud import PointCloud
from service.jobs import MAX_SAMPLE_POINTS, FoundImage, FoundPose, LocalizeOutcome, MapRef, RigidMotion
from service.worker.query_images import Query, photos_of


def localize_outcome(
    localization: Localization,
    maps: Sequence[MapRef],
    frame: Frame,
    timings_s: Mapping[str, float],
    pictures: dict[str, bytes],
    query: Query,
    change_cells: dict[str, Any] | None = None,
) -> LocalizeOutcome:
    """Return what a query found.

    maps: in the order that `Candidate.map_position` counts. frame: axes of the poses. timings_s: seconds measured around the
    search, added to its own. pictures: PNGs by name. query: what was localized. change_cells: what it saw changed.
    """
    best = localization.best
    return LocalizeOutcome(
        status=localization.status,
        best=None if best is None else _found_pose(best, maps, frame),
        alternatives=tuple(_found_pose(each, maps, frame) for each in localization.alternatives),
        accuracy_position_m=json_safe(localization.accuracy_position_m),
        accuracy_orientation_deg=json_safe(localization.accuracy_orientation_deg),
        panorama_changed_fraction=json_safe(localization.panorama_changed_fraction),
        map_changed_fraction=json_safe(localization.map_changed_fraction),
        timings_s=json_safe({**timings_s, **localization.timings_s}),
        search=json_safe(_figures(localization)),
        warnings=localization.warnings,
        pictures=pictures,
        map_from_session=_map_from_session(localization, query, frame),
        images=_found_images(localization, query, maps, frame),
        change_cells=change_cells,
    )


def stats_of(cloud: PointCloud, index: MapIndex, index_bytes: int, seconds: dict[str, float]) -> dict[str, Any]:
    """Return `stats` of a map as the HTTP contract promises them, positions in the scan's own frame, metres."""
    lower, upper = index.bounds
    stats: dict[str, Any] = json_safe(
        {
            "num_points": cloud.num_points_read or len(cloud),
            "num_points_used": index.num_points,
            "bounds": {"min": lower, "max": upper},
            "origin_offset": index.origin_offset,
            "num_starts": index.num_starts,
            "index_bytes": index_bytes,
            "seconds": seconds,
            "coordinate_system": cloud.coordinate_system,
        }
    )
    return stats


def starts_of(index: MapIndex) -> list[dict[str, Any]]:
    """Return position and leaf size of every start, metres, in the scan's own frame."""
    return [
        {"position_m": position, "leaf_size_m": size}
        for position, size in zip(index.start_positions.tolist(), index.start_leaf_sizes.tolist(), strict=True)
    ]


def sample_ply(cloud: PointCloud) -> bytes:
    """Return at most MAX_SAMPLE_POINTS coloured points as a binary PLY, shuffled so that every prefix is fair."""
    chosen = np.random.default_rng(0).permutation(len(cloud))[:MAX_SAMPLE_POINTS]
    return encode_ply(replace(cloud, positions=cloud.positions[chosen], colors=cloud.colors[chosen]))


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


def _found_pose(candidate: Candidate, maps: Sequence[MapRef], frame: Frame) -> FoundPose:
    position_m, quaternion_xyzw, matrix = _plain(candidate.pose.in_frame(frame))
    yaw, pitch, roll = (math.degrees(angle) for angle in candidate.pose.yaw_pitch_roll)
    return FoundPose(
        map=maps[candidate.map_position],
        confidence=json_safe(candidate.confidence),
        position_m=position_m,
        quaternion_xyzw=quaternion_xyzw,
        matrix=matrix,
        yaw_deg=json_safe(yaw),
        pitch_deg=json_safe(pitch),
        roll_deg=json_safe(roll),
    )


def _map_from_session(localization: Localization, query: Query, frame: Frame) -> RigidMotion | None:
    """Return it with both sides in the axes of `frame`. The frame of one camera without a pose is its session, in every axes."""
    if localization.best is None:
        return None
    if isinstance(query, Session) and localization.map_from_session is not None:
        return RigidMotion(*_plain(localization.map_from_session.between_worlds(frame)))
    return RigidMotion(*_plain(localization.best.pose.in_frame(frame)))


def _found_images(
    localization: Localization, query: Query, maps: Sequence[MapRef], frame: Frame
) -> tuple[FoundImage, ...]:
    """Return what the query's images are and, at the best pose, where."""
    photos, best = photos_of(query), localization.best
    if best is None:
        return tuple(_found_image(photo, None, None) for photo in photos)
    found = [(image.pose, image.agreement) for image in localization.images] or [(best.pose, None)]
    if len(found) == 1 and found[0][1] is None and localization.evidence is not None:
        # One image agrees as the whole query does.
        found = [(found[0][0], localization.evidence.measures.get("correlation"))]
    return tuple(
        _found_image(photo, _found_pose(replace(best, pose=pose), maps, frame), agreement)
        for photo, (pose, agreement) in zip(photos, found, strict=True)
    )


def _found_image(photo: Photo, pose: FoundPose | None, agreement: float | None) -> FoundImage:
    return FoundImage(pose, json_safe(agreement), photo.camera.model, round(photo.camera.hfov_deg, 3))


def _plain(pose: Pose) -> tuple[list[float], list[float], list[list[float]]]:
    """Return position, quaternion and matrix."""
    return json_safe(pose.position), json_safe(pose.quaternion_xyzw), json_safe(pose.matrix)


def _figures(localization: Localization) -> dict[str, Any]:
    best, evidence = localization.best, localization.evidence
    figures = asdict(localization.search)
    if best is not None:
        figures |= {"color_model": best.color_model, "sampling_loss": best.sampling_loss, "score": best.score}
        figures |= {"iterations": best.num_iterations, "num_iterations": best.num_iterations}
    return figures if evidence is None else figures | asdict(evidence)
