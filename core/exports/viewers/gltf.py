"""glTF 2.0: one named node with a camera per photo, y up, for three.js, Blender and engines."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from core.exports.angles import photo_angles
from core.exports.axes import GL_FROM_FLU, Y_UP_FROM_Z_UP
from core.exports.tour import ExportedFile, PlacedPhoto, Tour
from core.geometry.pose import quaternion_of


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.gltf`: nodes `panorama:NAME`, or `photo:NAME` of what is no full sphere, at its scene's root, camera along local −z.

    `extras` of a node have the angles of photographers from the map's y axis, those of the scene the georeference.
    """
    extras = {} if tour.georeference is None else {"extras": {"georeference": asdict(tour.georeference)}}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "panoloc"},
        "scene": 0,
        "scenes": [{"name": tour.name, "nodes": list(range(len(tour.photos))), **extras}],
        "nodes": [_node(photo) for photo in tour.photos],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.05}}],
    }
    if not tour.photos:  # no array of glTF may be empty
        del document["nodes"], document["scenes"][0]["nodes"]
    yield ExportedFile("tour.gltf", (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def _node(photo: PlacedPhoto) -> dict[str, Any]:
    pose = photo.map_from_camera
    angles = photo_angles(pose.rotation)
    return {
        "name": f"{'panorama' if photo.is_sphere else 'photo'}:{photo.name}",
        "translation": (Y_UP_FROM_Z_UP @ pose.position).tolist(),
        "rotation": quaternion_of(Y_UP_FROM_Z_UP @ pose.rotation @ GL_FROM_FLU.T).tolist(),
        "camera": 0,
        "extras": {**asdict(angles), "confidence": photo.confidence},
    }
