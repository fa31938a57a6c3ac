"""Tours for web viewers, with photos, links and a page: Potree, Photo Sphere Viewer, Pannellum."""

import html
import math
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from panoloc.core.exports.frames import photo_angles
from panoloc.core.exports.links import links_of
from panoloc.core.exports.tour import TIME_DECIMALS, ExportedFile, PlacedPhoto, Tour, json_file, plain, text_file
from panoloc.core.exports.web_pages import pannellum_page, potree_page, psv_page
from panoloc.core.scan.reading import read_points_of_map

_POTREE_COLUMNS = ("filename", "time", "long", "lat", "alt", "course", "pitch", "roll")
_ON_ITS_SIDE = 1e-9  # radians; nearer to a roll of 90 degrees than that the other two angles are one turn


def write_potree(tour: Tour) -> Iterator[ExportedFile]:
    """Yield photos, page, and `coordinates.txt` for the Images360Loader of Potree 1.8.

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
    yield potree_page(tour.name)
    yield from _images(tour)


def write_psv(tour: Tour) -> Iterator[ExportedFile]:
    """Yield photos, page, and `tour.json` for Photo Sphere Viewer from 5.15.1 on: options of its plugin for virtual tours.

    A node is turned so that yaw 0 looks along the map's y axis. Earlier versions have heading or roll inverted.
    """
    linked = _links(tour)
    nodes = [_psv_node(number, tour, linked[number]) for number in range(len(tour.photos))]
    yield json_file("tour.json", {"virtualTour": {"nodes": nodes}})
    yield psv_page(tour.name)
    yield from _images(tour)


def _psv_node(number: int, tour: Tour, linked: list[int]) -> dict[str, Any]:
    photo = tour.photos[number]
    angles = photo_angles(photo.map_from_camera.rotation)
    turns = {"pan": -angles.heading_deg, "tilt": -angles.elevation_deg, "roll": angles.roll_deg}
    sizes = {
        f"{of}{side}": size
        for of in ("full", "cropped")
        for side, size in (("Width", photo.width), ("Height", photo.height))
    }
    return {
        "id": str(number),
        "panorama": quote(photo.name),
        "name": html.escape(PurePosixPath(photo.name).name),  # the viewer takes it for HTML
        "sphereCorrection": {name: f"{plain(degrees)}deg" for name, degrees in turns.items()},
        # What a photo says of itself in GPano would turn it once more.
        "panoData": {**sizes, **dict.fromkeys(("croppedX", "croppedY", "poseHeading", "posePitch", "poseRoll"), 0)},
        "links": [{"nodeId": str(other), "position": _towards(photo, tour.photos[other])} for other in linked],
        # Not read by the viewer: for pages.
        "data": {"name": photo.name, "positionM": photo.map_from_camera.position.tolist()},
    }


def _towards(photo: PlacedPhoto, other: PlacedPhoto) -> dict[str, str]:
    heading, elevation = _direction(photo, other)
    return {"yaw": f"{plain(heading)}deg", "pitch": f"{plain(elevation)}deg"}


def write_pannellum(tour: Tour) -> Iterator[ExportedFile]:
    """Yield photos, page, and `pannellum.json` with one scene per photo; north is the map's y axis."""
    linked = _links(tour)
    scenes = {photo.name: _pannellum_scene(tour, photo, linked[number]) for number, photo in enumerate(tour.photos)}
    first = {"firstScene": next(iter(scenes), ""), "autoLoad": True}
    yield json_file("pannellum.json", {"default": first, "scenes": scenes})
    yield pannellum_page(tour.name)
    yield from _images(tour)


def _pannellum_scene(tour: Tour, photo: PlacedPhoto, linked: list[int]) -> dict[str, Any]:
    north, pitch, roll = _horizon(photo.map_from_camera.rotation)
    return {
        "type": "equirectangular",
        "panorama": quote(photo.name),
        "title": photo.name,
        "ignoreGPanoXMP": True,
        "northOffset": north,
        "horizonPitch": pitch,
        "horizonRoll": roll,
        "compass": True,
        "hotSpots": [_hot_spot(photo, tour.photos[other], north) for other in linked],
    }


def _hot_spot(photo: PlacedPhoto, other: PlacedPhoto, north: float) -> dict[str, Any]:
    heading, elevation = _direction(photo, other)
    yaw = (heading - north + 180.0) % 360.0 - 180.0
    place = {"yaw": yaw, "pitch": elevation, "targetYaw": "sameAzimuth"}
    return {"type": "scene", "sceneId": other.name, "text": PurePosixPath(other.name).name, **place}


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


def _links(tour: Tour) -> list[list[int]]:
    if tour.scan is None:
        return links_of(tour.positions, np.zeros((0, 3)))
    cloud = read_points_of_map(tour.scan)
    return links_of(tour.positions, cloud.positions.astype(np.float64) + cloud.origin_offset)


def _direction(photo: PlacedPhoto, other: PlacedPhoto) -> tuple[float, float]:
    """Return heading from the map's y axis and elevation in degrees at which a photo has another."""
    x, y, z = (other.map_from_camera.position - photo.map_from_camera.position).tolist()
    return math.degrees(math.atan2(x, y)) % 360.0, math.degrees(math.atan2(z, math.hypot(x, y)))


def _images(tour: Tour) -> Iterator[ExportedFile]:
    return (ExportedFile(photo.name, photo.image) for photo in tour.photos if photo.image is not None)
