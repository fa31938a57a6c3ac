"""Formats of photogrammetry: OpenSfM, nerfstudio, Agisoft Metashape."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from panoloc.core.earth.geopose import seen_from, turned_by
from panoloc.core.exports.earth import on_earth
from panoloc.core.exports.frames import CV_FROM_FLU, GL_FROM_FLU, cam_from_world
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file, plain
from panoloc.core.geometry.pose import Pose, quaternion_of
from panoloc.core.options import ScanOptions
from panoloc.core.scan.file_names import distinct_names
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.reading import read_points_of_map

_POINTS = "points.ply"


def write_opensfm(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the reconstruction. Its world is east, north, up of `reference_lla.json`, the map where that has no place on Earth.

    Poses are world to camera, axes right, down, forward; rotations are vectors in radians.
    """
    poses, origin = _in_world(tour)
    reconstruction = {
        "cameras": {
            _opensfm_camera(photo): {"projection_type": "spherical", "width": photo.width, "height": photo.height}
            for photo in tour.photos
        },
        "shots": {
            photo.name: _shot(photo, pose, time_unix_s)
            for photo, pose, time_unix_s in zip(tour.photos, poses, tour.times_unix_s, strict=True)
        },
        "points": {},
    }
    yield json_file("reconstruction.json", [reconstruction])
    if origin is not None:
        yield json_file("reference_lla.json", dict(zip(("latitude", "longitude", "altitude"), origin, strict=True)))


def _in_world(tour: Tour) -> tuple[list[Pose], tuple[float, float, float] | None]:
    """Return the poses, and the origin (latitude, longitude, height): that of the map, in a coordinate system the first photo."""
    place, poses = tour.georeference, [photo.map_from_camera for photo in tour.photos]
    if place is not None:
        axes = turned_by(place.heading_deg)
        turned = [Pose(axes @ pose.rotation, axes @ pose.position) for pose in poses]
        return turned, (place.latitude_deg, place.longitude_deg, place.height_m)
    if tour.coordinate_system is None or not poses:
        return poses, None
    places = [found for _, found, _ in on_earth(tour)]
    origin = places[0]
    return [seen_from(origin, each) for each in places], (origin.latitude_deg, origin.longitude_deg, origin.height_m)


def _opensfm_camera(photo: PlacedPhoto) -> str:
    return f"panoloc {photo.width} {photo.height} spherical"


def _shot(photo: PlacedPhoto, in_world: Pose, time_unix_s: float) -> dict[str, Any]:
    pose = cam_from_world(in_world)
    return {
        "camera": _opensfm_camera(photo),
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


def write_nerfstudio(tour: Tour) -> Iterator[ExportedFile]:
    """Yield poses from camera (right, up, backward) to the z-up map, and the points of the map where it has some.

    The fields that forbid turning and scaling are written out, because loaders assume COLMAP's axes without them. Its
    parser holds poses and points in single precision before it centres them. Large coordinates are therefore written without
    the offset `map_offset_m`.
    """
    offset = tour.offset_m
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


def _moved(scan: Path, offset: NDArray[np.float64]) -> bytes:
    cloud = read_points_of_map(scan, ScanOptions.max_points)
    positions = cloud.positions.astype(np.float64) + (cloud.origin_offset - offset)
    return encode_ply(replace(cloud, positions=positions.astype(np.float32), origin_offset=np.zeros(3)))


def _intrinsics(width: int, height: int) -> dict[str, float]:
    return {"w": width, "h": height, "fl_x": width / 2, "fl_y": height, "cx": width / 2, "cy": height / 2}


def _frame(photo: PlacedPhoto, offset: NDArray[np.float64], *, own_size: bool) -> dict[str, Any]:
    pose = photo.map_from_camera
    matrix = Pose(pose.rotation @ GL_FROM_FLU.T, pose.position - offset).matrix
    size = _intrinsics(photo.width, photo.height) if own_size else {}
    return {"file_path": photo.name, **size, "transform_matrix": matrix.tolist()}


def write_metashape(tour: Tour) -> Iterator[ExportedFile]:
    """Yield spherical sensors, one per size, and poses from camera (right, down, forward) to the chunk, which is the map.

    Cameras are labelled by file names without suffix, as Metashape labels photos; with it where two would be one.
    """
    document = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(document, "chunk", label=tour.name, enabled="true")
    sizes = sorted({(photo.width, photo.height) for photo in tour.photos})
    sensors = ElementTree.SubElement(chunk, "sensors", next_id=str(len(sizes)))
    for number, (width, height) in enumerate(sizes):
        sensor = ElementTree.SubElement(
            sensors, "sensor", id=str(number), label=f"spherical {width} x {height}", type="spherical"
        )
        ElementTree.SubElement(sensor, "resolution", width=str(width), height=str(height))
    _add_identity(chunk)
    labels = _labels([photo.name for photo in tour.photos])
    cameras = ElementTree.SubElement(chunk, "cameras", next_id=str(len(labels)), next_group_id="0")
    for number, (photo, label) in enumerate(zip(tour.photos, labels, strict=True)):
        sensor_id = str(sizes.index((photo.width, photo.height)))
        camera = ElementTree.SubElement(
            cameras, "camera", id=str(number), sensor_id=sensor_id, component_id="0", label=label, enabled="true"
        )
        pose = photo.map_from_camera
        matrix = Pose(pose.rotation @ CV_FROM_FLU.T, pose.position).matrix
        ElementTree.SubElement(camera, "transform").text = " ".join(plain(value, 15) for value in matrix.ravel())
    ElementTree.indent(document, " ")
    yield ExportedFile("cameras.xml", ElementTree.tostring(document, "utf-8", xml_declaration=True) + b"\n")


def _add_identity(chunk: ElementTree.Element) -> None:
    """Say that the chunk is the map: readers apply the transforms of component and chunk on top of those of cameras."""
    components = ElementTree.SubElement(chunk, "components", next_id="1", active_id="0")
    component = ElementTree.SubElement(components, "component", id="0", label="Component 1")
    for parent in (component, chunk):
        transform = ElementTree.SubElement(parent, "transform")
        ElementTree.SubElement(transform, "rotation").text = "1 0 0 0 1 0 0 0 1"
        ElementTree.SubElement(transform, "translation").text = "0 0 0"
        ElementTree.SubElement(transform, "scale").text = "1"


def _labels(names: list[str]) -> list[str]:
    stems = [PurePosixPath(name).stem for name in names]
    once = {stem for stem, count in Counter(stems).items() if count == 1}
    return distinct_names(stem if stem in once else name for stem, name in zip(stems, names, strict=True))
