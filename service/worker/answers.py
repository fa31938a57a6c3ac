"""Builds from the result of `core` the answer of the HTTP contract, and the cells of the map that it saw changed."""

import base64
import io
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.camera.rig import Photo, Rig
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Candidate, Localization
from panoloc.service import answer
from panoloc.service.answer import (
    Accuracy,
    Alternative,
    Change,
    ImageAnswer,
    ImageCamera,
    PoseAnswer,
    RigidMotion,
)
from panoloc.service.jobs import ARTIFACTS, ChangePhoto, LocalizeJob
from panoloc.service.poses import PlaceOnEarth, geopose, motion, pose_answer
from panoloc.service.worker.query_images import shown_on_sphere

_ACCURACY_LEVEL = 0.68
# Small enough to keep for weeks, coarse enough that several answers agree.
_CELL_M = 0.15
_MOST_CELLS_ACROSS = 30_000  # int16
_MOST_POINTS = 60_000
_PHOTO_PX = 1024  # its width: 20 pixels across 0.3 m at 3 m, in 100 kB
_LEAST_POINTS = 3  # of a cell, for a meaningful mean


def answer_of(
    found: Localization,
    job: LocalizeJob,
    photos: Sequence[Photo],
    timings_s: Mapping[str, float],
    pictures: Mapping[str, bytes],
) -> answer.Localization:
    """Return the answer to a query. Of one that is `not_localized`, the best guess is the first alternative.

    photos: the images of the query. timings_s: seconds measured
    around the search, added to its own. pictures: PNGs by name.
    """
    is_placed = found.status != "not_localized"
    best = found.best if is_placed else None
    others = found.alternatives if is_placed or found.best is None else (found.best, *found.alternatives)
    return answer.Localization(
        id=job.localization_id,
        status=found.status,
        map_id=best and job.maps[best.map_position].id,
        map_revision=best and job.maps[best.map_position].revision,
        pose=best and _pose(best, job),
        map_from_session=best and _map_from_session(found, best, job),
        images=_images(found, photos, job),
        geopose=best and geopose(best.pose, _place(best, job)),
        confidence=found.best.confidence if found.best else 0.0,
        accuracy=best
        and Accuracy(
            position_m=finite(found.accuracy_position_m),
            orientation_deg=finite(found.accuracy_orientation_deg),
            level=_ACCURACY_LEVEL,
        ),
        alternatives=[
            Alternative(pose=_pose(each, job), confidence=each.confidence, map_id=job.maps[each.map_position].id)
            for each in others
        ],
        change=Change(
            panorama_changed_fraction=finite(found.panorama_changed_fraction),
            map_changed_fraction=finite(found.map_changed_fraction),
        ),
        timings_s={**timings_s, **found.timings_s},
        search=json_safe(_figures(found)),
        warnings=list(found.warnings),
        reasons=[remark.reason for remark in found.warnings],
        artifacts={name: answer.picture_path(job.localization_id, name) for name in ARTIFACTS if name in pictures},
    )


def finite(value: float | None) -> float | None:
    """Return a number, None for NaN and infinity, which JSON cannot express."""
    return None if value is None or not math.isfinite(value) else float(value)


def json_safe(value: Any) -> Any:
    """Return `value` with plain numbers and lists for those of numpy, and None for NaN and infinity."""
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_safe(value.tolist())
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    return finite(value) if isinstance(value, float) else value


def _pose(candidate: Candidate, job: LocalizeJob) -> PoseAnswer:
    return pose_answer(candidate.pose, job.options.frame, _place(candidate, job))


def _place(candidate: Candidate, job: LocalizeJob) -> PlaceOnEarth | None:
    return job.georeferences.get(job.maps[candidate.map_position].id)


def _map_from_session(found: Localization, best: Candidate, job: LocalizeJob) -> RigidMotion:
    """Return `map_from_session` in the axes of the query. A single camera without a pose is its own session."""
    if job.images[0].session_from_camera is not None and found.map_from_session is not None:
        return motion(found.map_from_session.between_worlds(job.options.frame))
    return motion(best.pose.in_frame(job.options.frame))


def _images(found: Localization, photos: Sequence[Photo], job: LocalizeJob) -> list[ImageAnswer]:
    """Return camera, agreement and, unless `not_localized`, pose of each image."""
    best = found.best
    if best is None:
        return [ImageAnswer(pose=None, agreement=None, camera=_camera(photo)) for photo in photos]
    placed = [(image.pose, image.agreement) for image in found.images] or [(best.pose, None)]
    if len(placed) == 1 and placed[0][1] is None and found.evidence is not None:
        # One image agrees as the whole query does.
        placed = [(placed[0][0], found.evidence.measures.get("correlation"))]
    return [
        ImageAnswer(
            pose=None if found.status == "not_localized" else _pose(replace(best, pose=pose), job),
            agreement=finite(agreement),
            camera=_camera(photo),
        )
        for photo, (pose, agreement) in zip(photos, placed, strict=True)
    ]


def _camera(photo: Photo) -> ImageCamera:
    return ImageCamera(model=photo.camera.model, hfov_deg=round(photo.camera.hfov_deg, 3))


def _figures(found: Localization) -> dict[str, Any]:
    best, evidence = found.best, found.evidence
    figures = asdict(found.search)
    if best is not None:
        figures |= {"color_model": best.color_model, "sampling_loss": best.sampling_loss, "score": best.score}
        figures |= {"iterations": best.num_iterations, "num_iterations": best.num_iterations}
    return figures if evidence is None else figures | asdict(evidence)


def change_cells(index: MapIndex, localization: Localization) -> dict[str, Any] | None:
    """Return the cells in view, and those of them that changed; None for an answer that is not `localized`.

    `cell_m`: edge in metres. `seen`, `changed`: cells as (n, 3) int16, in units of `cell_m` from the map's origin
    without its offset; little-endian, deflated, base64. `changed` is a subset of `seen`.
    """
    scores = localization.point_scores
    if scores is None or localization.status != "localized":
        return None
    known = np.flatnonzero(~np.isnan(scores))
    # Every k-th point is an even sample of the scan: enough for cells, in a tenth of the time.
    known = known[:: max(1, len(known) // _MOST_POINTS)]
    positions = index.positions.cpu().numpy()[known]
    cell_m = max(_CELL_M, float(np.abs(positions).max(initial=0.0)) / _MOST_CELLS_ACROSS)
    places = np.floor(positions / cell_m).astype(np.int64)
    keys, first, of_point = np.unique(
        (places[:, 0] << 34) + (places[:, 1] << 17) + places[:, 2], return_index=True, return_inverse=True
    )
    counts = np.bincount(of_point, minlength=len(keys))
    means = np.bincount(of_point, scores[known], len(keys)) / np.maximum(counts, 1)
    cells = places[first].astype(np.int16)
    enough = counts >= _LEAST_POINTS
    changed = enough & (means < 0.5)
    return {"cell_m": cell_m, "seen": _packed(cells[enough]), "changed": _packed(cells[changed])}


def change_photo(query: Rig, localization: Localization) -> ChangePhoto | None:
    """Return the photo that objects which changed are found in; None for an answer that is not `localized`."""
    if localization.status != "localized":
        return None
    panorama, placed = shown_on_sphere(query, localization)
    assert placed.best is not None
    pixels = np.dstack((panorama.color, 255 * panorama.valid)).astype(np.uint8)
    file = io.BytesIO()
    # As alpha marks what is missing, colours below it are not wanted either.
    Image.fromarray(pixels).resize((_PHOTO_PX, _PHOTO_PX // 2), Image.Resampling.BOX).save(file, "WEBP", quality=85)
    x, y, z = placed.best.pose.position.tolist()
    a, b, c, d = placed.best.pose.quaternion_xyzw.tolist()
    return ChangePhoto(file.getvalue(), (x, y, z), (a, b, c, d))


def _packed(cells: NDArray[np.int16]) -> str:
    return base64.b64encode(zlib.compress(cells.astype("<i2").tobytes())).decode("ascii")
