"""OpenSfM: `reconstruction.json`, and `reference_lla.json` where the map has a georeference."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.exports.axes import cam_from_world
from panoloc.core.exports.geodesy import enu_from_map
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file
from panoloc.core.geometry.pose import Pose, quaternion_of


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the reconstruction. Its world is east, north, up of `reference_lla.json`, without a georeference the map.

    Poses are world to camera, axes right, down, forward; rotations are vectors in radians.
    """
    world = np.eye(3) if tour.georeference is None else enu_from_map(tour.georeference)
    reconstruction = {
        "cameras": {
            _camera_of(photo): {"projection_type": "spherical", "width": photo.width, "height": photo.height}
            for photo in tour.photos
        },
        "shots": {
            photo.name: _shot(photo, world, time_unix_s)
            for photo, time_unix_s in zip(tour.photos, tour.times_unix_s, strict=True)
        },
        "points": {},
    }
    yield json_file("reconstruction.json", [reconstruction])
    place = tour.georeference
    if place is not None:
        origin = {"latitude": place.latitude_deg, "longitude": place.longitude_deg, "altitude": place.height_m}
        yield json_file("reference_lla.json", origin)


def _camera_of(photo: PlacedPhoto) -> str:
    return f"panoloc {photo.width} {photo.height} spherical"


def _shot(photo: PlacedPhoto, world_from_map: NDArray[np.float64], time_unix_s: float) -> dict[str, Any]:
    in_world = Pose(world_from_map @ photo.map_from_camera.rotation, world_from_map @ photo.map_from_camera.position)
    pose = cam_from_world(in_world)
    return {
        "camera": _camera_of(photo),
        "rotation": _rotation_vector(pose.rotation).tolist(),
        "translation": pose.position.tolist(),
        "capture_time": time_unix_s,
        "orientation": 1,
    }


def _rotation_vector(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return axis times angle in radians, by way of the quaternion: exact for small angles and half turns."""
    quaternion = quaternion_of(rotation)
    sine = float(np.linalg.norm(quaternion[:3]))
    angle = 2 * float(np.arctan2(sine, quaternion[3]))
    vector: NDArray[np.float64] = quaternion[:3] * (angle / sine if sine > 1e-12 else 2.0)
    return vector
