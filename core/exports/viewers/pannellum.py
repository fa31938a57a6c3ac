"""Pannellum: the configuration of a tour."""

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.exports.tour import ExportedFile, PlacedPhoto, Tour

_ON_ITS_SIDE = 1e-9  # radians; nearer to a roll of 90 degrees than that the other two angles are one turn


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `pannellum.json` with one scene per photo; north is the map's y axis."""
    scenes = {photo.name: _scene(photo) for photo in tour.photos}
    document = {"default": {"firstScene": next(iter(scenes), "")}, "scenes": scenes}
    yield ExportedFile("pannellum.json", (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def _scene(photo: PlacedPhoto) -> dict[str, Any]:
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
