"""Photo Sphere Viewer from 5.15.1 on: the nodes of its virtual tour. Earlier versions have heading or roll inverted."""

import json
from collections.abc import Iterator
from typing import Any

from core.exports.angles import photo_angles
from core.exports.number_text import plain
from core.exports.tour import ExportedFile, PlacedPhoto, Tour


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.json`: options of the viewer, and one node per photo, turned so that yaw 0 looks along the map's y axis."""
    document = {
        "viewer": {"useXmpData": False},
        "virtualTour": {"nodes": [_node(number, photo) for number, photo in enumerate(tour.photos)]},
    }
    yield ExportedFile("tour.json", (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def _node(number: int, photo: PlacedPhoto) -> dict[str, Any]:
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
