"""nerfstudio: `transforms.json`, which lies in the folder of the photos."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from core.exports.axes import GL_FROM_FLU
from core.exports.tour import ExportedFile, PlacedPhoto, Tour
from core.geometry.pose import Pose

_POINTS = "points.ply"


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield poses from camera (right, up, backward) to the map, whose z is up, and the points of the map where there are some.

    The fields that forbid turning and scaling are written out, because loaders assume COLMAP's axes without them.
    """
    has_points = tour.scan is not None and tour.scan.suffix == ".ply"
    document: dict[str, Any] = {
        "camera_model": "EQUIRECTANGULAR",
        "orientation_override": "none",
        "applied_transform": np.eye(3, 4).tolist(),
        **({"ply_file_path": _POINTS} if has_points else {}),
    }
    sizes = {(photo.width, photo.height) for photo in tour.photos}
    if len(sizes) == 1:
        document |= _intrinsics(*next(iter(sizes)))
    document["frames"] = [_frame(photo, own_size=len(sizes) > 1) for photo in tour.photos]
    yield ExportedFile("transforms.json", (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())
    if has_points and tour.scan is not None:
        yield ExportedFile(_POINTS, tour.scan)


def _intrinsics(width: int, height: int) -> dict[str, float]:
    return {"w": width, "h": height, "fl_x": width / 2, "fl_y": height, "cx": width / 2, "cy": height / 2}


def _frame(photo: PlacedPhoto, *, own_size: bool) -> dict[str, Any]:
    pose = photo.map_from_camera
    matrix = Pose(pose.rotation @ GL_FROM_FLU.T, pose.position).matrix
    size = _intrinsics(photo.width, photo.height) if own_size else {}
    return {"file_path": photo.name, **size, "transform_matrix": matrix.tolist()}
