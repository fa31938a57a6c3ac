"""COLMAP text model with its EQUIRECTANGULAR camera, which COLMAP knows since 4.1.0."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from panoloc.core.exports.axes import cam_from_world, quaternion_wxyz
from panoloc.core.exports.number_text import plain
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, text_file
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan

_DECIMALS = 15  # positions are multiplied by rotations: in national grids nine would lose millimetres
_MAX_POINTS = 200_000


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if " " in photo.name:
        return "its name has a space, which ends a name in COLMAP's text files; rename the photo"
    return None


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield cameras, images (camera from world; axes right, down, forward) and the map's points without tracks."""
    sizes = sorted({(photo.width, photo.height) for photo in tour.photos})
    cameras = [
        f"{number} EQUIRECTANGULAR {width} {height} {width} {height}" for number, (width, height) in enumerate(sizes, 1)
    ]
    yield table("cameras.txt", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", cameras)
    images = []
    for number, photo in enumerate(tour.photos, 1):
        camera = sizes.index((photo.width, photo.height)) + 1
        # Without its second line, which names points, an image would swallow the next one.
        images += [f"{number} {pose_text(cam_from_world(photo.map_from_camera))} {camera} {photo.name}", ""]
    yield table("images.txt", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[]", images)
    yield table("points3D.txt", "POINT3D_ID X Y Z R G B ERROR TRACK[]", points_of(tour.scan))


def table(name: str, columns: str, lines: Sequence[str]) -> ExportedFile:
    """Return a file of a text model."""
    return text_file(name, (f"# {columns}", *lines))


def pose_text(pose: Pose) -> str:
    """Return QW QX QY QZ TX TY TZ."""
    return " ".join(plain(value, _DECIMALS) for value in (*quaternion_wxyz(pose.rotation), *pose.position))


def points_of(scan: Path | None) -> list[str]:
    """Return the lines of the points of a map, thinned to what a text file can bear; none without a scan."""
    if scan is None:
        return []
    cloud = read_scan(scan, ScanOptions(max_points_used=_MAX_POINTS))
    positions = cloud.positions.astype(np.float64) + cloud.origin_offset
    return [
        f"{number} {' '.join(plain(value, 6) for value in position)} {' '.join(map(str, color))} 0"
        for number, (position, color) in enumerate(zip(positions.tolist(), cloud.colors.tolist(), strict=True), 1)
    ]
