"""Tours with known poses: the golden one of the formats, and many turned every way."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from panoloc.core.earth.geopose import Georeference
from panoloc.core.exports.formats import export
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ExportFormat
from tests.core import painted_box
from tests.core.image.picture_files import encoded

WIDTH, HEIGHT = 2048, 1024
GEOREFERENCE = Georeference(47.7, -122.3, 11.5, 0.0)
TIME_UNIX_S = 1750939398.316
POINT = np.array([4.0, 1.0, 0.5])
"""A point of the map, and the pixel (column, row) where the golden pose sees it."""
PIXEL = 1028.387681, 520.952120
WALK_PAGE = Path(__file__).parent / "walk_page"
"""In place of the built one, which quick tests do not need."""
LARGE = np.array([431_250.25, 5_312_480.5, 412.75])


def rotation_of(heading_deg: float, elevation_deg: float, roll_deg: float) -> np.ndarray:
    """Return Rz(90° − heading) · Ry(−elevation) · Rx(roll)."""
    return painted_box.rotation_of(90 - heading_deg, -elevation_deg, roll_deg)


GOLDEN = Pose(rotation_of(37.5, -12.25, 4.75), np.array([1.25, -2.5, 1.6]))


def directions(seed: int = 0, number: int = 24) -> np.ndarray:
    """Return known directions (number, 3) all over the sphere."""
    drawn = np.random.default_rng(seed).normal(size=(number, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def jpeg(width: int = 64, height: int = 32) -> bytes:
    """Return a small picture."""
    ramp = np.linspace(0, 255, width * height * 3).reshape(height, width, 3)
    return encoded(ramp.astype(np.uint8), "JPEG")


def golden_tour(folder: Path | None = None, georeference: Georeference | None = GEOREFERENCE) -> Tour:
    """Return the golden pose as a tour of one photo. folder: where its file is put; None: there is none."""
    image = None
    if folder is not None:
        image = folder / "pano.jpg"
        image.write_bytes(jpeg())
    photo = PlacedPhoto(
        "pano.jpg",
        GOLDEN,
        WIDTH,
        HEIGHT,
        time_unix_s=TIME_UNIX_S,
        confidence=0.93,
        position_radius_m=0.02,
        orientation_radius_deg=0.3,
        image=image,
    )
    return Tour("map_1", (photo,), georeference=georeference, created_unix_s=TIME_UNIX_S, page=WALK_PAGE)


def turned_tour(folder: Path, upright: bool = False) -> Tour:
    """Return 100 photos turned at random, and those at the poles and the seam, some of them far from the origin of the map.

    upright: without rolls beyond a right angle.
    """
    random = np.random.default_rng(12)
    image = folder / "photo.jpg"
    image.write_bytes(jpeg())
    rotations = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(100)]
    rotations = [rotation * np.sign(np.linalg.det(rotation)) for rotation in rotations]
    rotations += [rotation_of(heading, up, 0) for heading in (0, 90, 123, 270, 359.9999) for up in (90, -90)]
    rotations += [rotation_of(heading, 10, roll) for heading in (0, 90, 180, 270, 360) for roll in (0, 90, -90, 180)]
    rotations += [rotation_of(heading, 0, 0) for heading in (269.999999999, 270.000000001)]
    if upright:
        rotations = [rotation for rotation in rotations if rotation[2, 2] >= -1e-12]
    photos = tuple(
        PlacedPhoto(
            f"room_{number % 3}/{number:03}.jpg",
            Pose(rotation, random.normal(size=3) * 5 + (LARGE if number % 2 else 0)),
            WIDTH,
            HEIGHT,
            time_unix_s=TIME_UNIX_S + number,
            image=image,
        )
        for number, rotation in enumerate(rotations)
    )
    return Tour("map_1", photos, page=WALK_PAGE)


def written(format_name: ExportFormat, tour: Tour, folder: Path) -> Path:
    """Write an export into a folder, and return it."""
    for file in export(format_name, tour):
        target = folder / file.path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(file.content if isinstance(file.content, bytes) else file.content.read_bytes())
    return folder


def document_of(format_name: ExportFormat, tour: Tour, folder: Path, file: str = "export.json") -> Any:
    """Write an export into a folder, and return one of its documents of JSON."""
    return json.loads((written(format_name, tour, folder) / file).read_text())
