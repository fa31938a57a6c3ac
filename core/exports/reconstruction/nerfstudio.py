"""nerfstudio: `transforms.json`, which lies in the folder of the photos.

Its parser holds poses and points in single precision before it centres them: survey coordinates, in the millions, would
be half a metre off. Large coordinates are therefore written without the offset `map_offset_m`.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.exports.axes import GL_FROM_FLU
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.reading import read_scan

_POINTS = "points.ply"
_LARGE_M = 1000.0  # single precision resolves 0.06 mm there


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield poses from camera (right, up, backward) to the z-up map, and the points of the map where it has some.

    The fields that forbid turning and scaling are written out, because loaders assume COLMAP's axes without them.
    """
    offset = _offset(tour)
    has_points = tour.scan is not None and tour.scan.suffix == ".ply"
    document: dict[str, Any] = {
        "camera_model": "EQUIRECTANGULAR",
        "orientation_override": "none",
        "applied_transform": np.eye(3, 4).tolist(),
        **({"ply_file_path": _POINTS} if has_points else {}),
        # Our own field: add it to positions to have those of the map.
        **({"map_offset_m": offset.tolist()} if offset.any() else {}),
    }
    sizes = {(photo.width, photo.height) for photo in tour.photos}
    if len(sizes) == 1:
        document |= _intrinsics(*next(iter(sizes)))
    document["frames"] = [_frame(photo, offset, own_size=len(sizes) > 1) for photo in tour.photos]
    yield json_file("transforms.json", document)
    if has_points and tour.scan is not None:
        yield ExportedFile(_POINTS, _moved(tour.scan, offset) if offset.any() else tour.scan)


def _offset(tour: Tour) -> NDArray[np.float64]:
    """Return the offset (3,), in whole metres, that brings the photos near the origin; zero where they are near it."""
    positions = np.array([photo.map_from_camera.position for photo in tour.photos]).reshape(-1, 3)
    if not len(positions) or np.abs(positions).max() <= _LARGE_M:
        return np.zeros(3)
    return np.asarray(np.rint((positions.min(axis=0) + positions.max(axis=0)) / 2))


def _moved(scan: Path, offset: NDArray[np.float64]) -> bytes:
    cloud = read_scan(scan, ScanOptions(max_points_used=ScanOptions.max_points))
    positions = cloud.positions.astype(np.float64) + (cloud.origin_offset - offset)
    return encode_ply(replace(cloud, positions=positions.astype(np.float32), origin_offset=np.zeros(3)))


def _intrinsics(width: int, height: int) -> dict[str, float]:
    return {"w": width, "h": height, "fl_x": width / 2, "fl_y": height, "cx": width / 2, "cy": height / 2}


def _frame(photo: PlacedPhoto, offset: NDArray[np.float64], *, own_size: bool) -> dict[str, Any]:
    pose = photo.map_from_camera
    matrix = Pose(pose.rotation @ GL_FROM_FLU.T, pose.position - offset).matrix
    size = _intrinsics(photo.width, photo.height) if own_size else {}
    return {"file_path": photo.name, **size, "transform_matrix": matrix.tolist()}
