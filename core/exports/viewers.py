"""Formats of viewers that show photos in place: Potree, NavVis, Photo Sphere Viewer, Pannellum, glTF."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.exports.frames import GL_FROM_FLU, Y_UP_FROM_Z_UP, photo_angles, quaternion_wxyz
from panoloc.core.exports.tour import TIME_DECIMALS, ExportedFile, PlacedPhoto, Tour, json_file, plain, text_file
from panoloc.core.geometry.pose import quaternion_of

_POTREE_COLUMNS = ("filename", "time", "long", "lat", "alt", "course", "pitch", "roll")
_NAVVIS_COLUMNS = (
    *("ID", "filename", "timestamp", "pano_pos_x", "pano_pos_y", "pano_pos_z"),
    *("pano_ori_w", "pano_ori_x", "pano_ori_y", "pano_ori_z"),
)
_ON_ITS_SIDE = 1e-9  # radians; nearer to a roll of 90 degrees than that the other two angles are one turn


def write_potree(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `coordinates.txt` for the Images360Loader of Potree 1.8, which lies in the folder of the photos.

    Positions are map coordinates, `course` clockwise from the map's y axis, `pitch` up, `roll` right side down. There are
    eight columns, because forks read a ninth as part of a quaternion. The loader always skips the first line.
    """
    lines = ["\t".join(_POTREE_COLUMNS)]
    for photo, time_unix_s in zip(tour.photos, tour.times_unix_s, strict=True):
        pose = photo.map_from_camera
        angles = photo_angles(pose.rotation)
        numbers = [*pose.position, angles.heading_deg, angles.elevation_deg, angles.roll_deg]
        lines.append("\t".join([photo.name, plain(time_unix_s, TIME_DECIMALS), *map(plain, numbers)]))
    yield text_file("coordinates.txt", lines)


def write_navvis(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the photos under the names that NavVis asks for, `pano-poses.csv` and what the photos were called.

    The quaternion has w first, body axes are x forward, y left, z up.
    """
    lines, names = [f"# pano poses v1.0: {'; '.join(_NAVVIS_COLUMNS)}"], ["# filename; name of the photo"]
    for number, (photo, time_unix_s) in enumerate(zip(tour.photos, tour.times_unix_s, strict=True)):
        pose = photo.map_from_camera
        file_name = f"{number:05}-pano{PurePosixPath(photo.name).suffix or '.jpg'}"
        numbers = [time_unix_s, *pose.position, *quaternion_wxyz(pose.rotation)]
        lines.append("; ".join([str(number), file_name, *(_six_decimals(value) for value in numbers)]))
        names.append(f"{file_name}; {photo.name}")
        if photo.image is not None:
            yield ExportedFile(file_name, photo.image)
    yield text_file("pano-poses.csv", lines)
    yield text_file("names.csv", names)


def _six_decimals(value: float) -> str:
    text = f"{value:.6f}"
    return text.removeprefix("-") if float(text) == 0 else text


def write_psv(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.json` for Photo Sphere Viewer from 5.15.1 on: its options, and one node of its virtual tour per photo.

    A node is turned so that yaw 0 looks along the map's y axis. Earlier versions have heading or roll inverted.
    """
    nodes = [_psv_node(number, photo) for number, photo in enumerate(tour.photos)]
    yield json_file("tour.json", {"viewer": {"useXmpData": False}, "virtualTour": {"nodes": nodes}})


def _psv_node(number: int, photo: PlacedPhoto) -> dict[str, Any]:
    angles = photo_angles(photo.map_from_camera.rotation)
    turns = {"pan": -angles.heading_deg, "tilt": -angles.elevation_deg, "roll": angles.roll_deg}
    return {
        "id": str(number),
        "panorama": photo.name,
        "name": photo.name,
        "sphereCorrection": {name: f"{plain(degrees)}deg" for name, degrees in turns.items()},
        "links": [],
        # Not read by the viewer: for code that makes links of it.
        "data": {"positionM": photo.map_from_camera.position.tolist()},
    }


def write_pannellum(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `pannellum.json` with one scene per photo; north is the map's y axis."""
    scenes = {photo.name: _pannellum_scene(photo) for photo in tour.photos}
    yield json_file("pannellum.json", {"default": {"firstScene": next(iter(scenes), "")}, "scenes": scenes})


def _pannellum_scene(photo: PlacedPhoto) -> dict[str, Any]:
    north, pitch, roll = _horizon(photo.map_from_camera.rotation)
    return {
        "type": "equirectangular",
        "panorama": photo.name,
        "title": photo.name,
        "northOffset": north,
        "horizonPitch": pitch,
        "horizonRoll": roll,
        "compass": True,
    }


def _horizon(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return northOffset, horizonPitch and horizonRoll in degrees.

    Pannellum turns by roll after pitch: rotation = Rz(90° − north) · Rx(roll) · Ry(−pitch), not in the order of GPano.
    """
    r = rotation
    level = math.hypot(r[0, 1], r[1, 1])
    roll = math.atan2(r[2, 1], level)
    if level < _ON_ITS_SIDE:
        north, pitch = math.atan2(-r[1, 0], r[0, 0]), 0.0
    else:
        north, pitch = math.atan2(r[0, 1], r[1, 1]), math.atan2(r[2, 0], r[2, 2])
    return (math.degrees(north) + 90.0) % 360.0, math.degrees(pitch), math.degrees(roll)


def write_gltf(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.gltf` (glTF 2.0, y up): a node with a camera along local −z per photo, `panorama:NAME` or `photo:NAME`.

    `extras` of a node have heading, elevation and roll from the map's y axis, those of the scene the georeference.
    """
    extras = {} if tour.georeference is None else {"extras": {"georeference": asdict(tour.georeference)}}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "panoloc"},
        "scene": 0,
        "scenes": [{"name": tour.name, "nodes": list(range(len(tour.photos))), **extras}],
        "nodes": [_gltf_node(photo) for photo in tour.photos],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.05}}],
    }
    if not tour.photos:  # no array of glTF may be empty
        del document["nodes"], document["scenes"][0]["nodes"]
    yield json_file("tour.gltf", document)


def _gltf_node(photo: PlacedPhoto) -> dict[str, Any]:
    pose = photo.map_from_camera
    return {
        "name": f"{'panorama' if photo.is_sphere else 'photo'}:{photo.name}",
        "translation": (Y_UP_FROM_Z_UP @ pose.position).tolist(),
        "rotation": quaternion_of(Y_UP_FROM_Z_UP @ pose.rotation @ GL_FROM_FLU.T).tolist(),
        "camera": 0,
        "extras": {**asdict(photo_angles(pose.rotation)), "confidence": photo.confidence},
    }
