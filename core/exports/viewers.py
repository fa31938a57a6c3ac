"""Formats of viewers that show photos in place: NavVis, glTF; those of the web are in `web_tours`."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.exports.frames import GL_FROM_FLU, Y_UP_FROM_Z_UP, photo_angles, quaternion_wxyz
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file, text_file
from panoloc.core.geometry.pose import quaternion_of

_NAVVIS_COLUMNS = (
    *("ID", "filename", "timestamp", "pano_pos_x", "pano_pos_y", "pano_pos_z"),
    *("pano_ori_w", "pano_ori_x", "pano_ori_y", "pano_ori_z"),
)


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


def write_gltf(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.gltf` (glTF 2.0, y up): a node with a camera along local −z per photo, `panorama:NAME` or `photo:NAME`.

    `extras` of a node have heading, elevation and roll from the map's y axis; those of the scene the georeference. Readers hold nodes
    in single precision: large coordinates are written without an offset, `map_offset_m` of the scene along x, y, z of the map.
    """
    offset = tour.offset_m
    extras: dict[str, Any] = {} if tour.georeference is None else {"georeference": asdict(tour.georeference)}
    if offset.any():
        extras["map_offset_m"] = offset.tolist()
    scene = {"name": tour.name, "nodes": list(range(len(tour.photos))), **({"extras": extras} if extras else {})}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "panoloc"},
        "scene": 0,
        "scenes": [scene],
        "nodes": [_gltf_node(photo, offset) for photo in tour.photos],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.05}}],
    }
    if not tour.photos:  # no array of glTF may be empty
        del document["nodes"], scene["nodes"]
    yield json_file("tour.gltf", document)


def _gltf_node(photo: PlacedPhoto, offset: NDArray[np.float64]) -> dict[str, Any]:
    pose = photo.map_from_camera
    return {
        "name": f"{'panorama' if photo.is_sphere else 'photo'}:{photo.name}",
        "translation": (Y_UP_FROM_Z_UP @ (pose.position - offset)).tolist(),
        "rotation": quaternion_of(Y_UP_FROM_Z_UP @ pose.rotation @ GL_FROM_FLU.T).tolist(),
        "camera": 0,
        "extras": {**asdict(photo_angles(pose.rotation)), "confidence": photo.confidence},
    }
