"""A walk-through for a client: a folder whose `index.html` opens by a double click, without a service or a network.

Browsers let a page from a folder neither fetch its files nor read the pixels of its pictures. So whatever the page computes with
(`data.js`, photos for the sphere) is a script with the data in it; thumbnails and plans are plain pictures.
"""

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from typing import Any

import numpy as np

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.floor_plan import Array, FloorPicture, Points, Storey, draw_storey, points_of, storeys_of
from panoloc.core.exports.links import links_of
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour
from panoloc.core.exports.walk_photos import has_large, photo_files
from panoloc.core.scan.file_names import display_name

PAGE_FILES = {"index.html": "index.html", "page.js": "walk/page.js", "page.css": "walk/page.css"}
"""Of the built page, and where they lie in the export."""
_AT_ONCE = 4  # photos that are decoded: each takes up to 300 MB


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be walked to, None when it can."""
    return None if photo.image is not None else "its file no longer exists"


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the page, its data, a plan per floor, and each photo in up to three sizes. Raises ExportRefusedError without a built page."""
    page = tour.page
    if page is None or not all((page / name).is_file() for name in PAGE_FILES):
        raise ExportRefusedError(
            "tour: expected the page of the walk-through, which is built with the console, found none; run "
            "scripts/build-console in the source folder of whoever writes the export, then export again"
        )
    yield from (ExportedFile(path, page / name) for name, path in PAGE_FILES.items())
    points = points_of(tour)
    storeys = storeys_of(tour.photos, tour.floor_levels_m, points)
    pictures = [draw_storey(storey, tour.photos, points) for storey in storeys]
    document = walk_document(tour, storeys, pictures, points)
    yield ExportedFile("walk/data.js", f"window.panolocWalk = {json.dumps(document)};\n".encode())
    for number, picture in enumerate(pictures):
        yield ExportedFile(_floor_file(number), picture.webp())
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        for first in range(0, len(tour.photos), _AT_ONCE):
            group = tour.photos[first : first + _AT_ONCE]
            for files in threads.map(photo_files, range(first, first + len(group)), group):
                yield from files


def walk_document(
    tour: Tour, storeys: Sequence[Storey], pictures: Sequence[FloorPicture], points: Points
) -> dict[str, Any]:
    """Return what the page knows of the tour; `walk_data.ts` of the console says the same in TypeScript.

    Positions are metres from `origin`, because graphics processors compute in single precision. Rotations have rows, from camera (x
    forward, y left, z up) to map.
    """
    places = np.array([photo.map_from_camera.position for photo in tour.photos]).reshape(-1, 3)
    origin = tour.offset_m
    floor_of = {number: floor for floor, storey in enumerate(storeys) for number in storey.photos}
    links = links_of(places, points.positions)
    return {
        "title": display_name(tour.title or tour.name),
        "origin": origin.tolist(),
        "floors": [_floor(number, *each, origin) for number, each in enumerate(zip(storeys, pictures, strict=True))],
        "photos": [
            {**_photo(photo, origin), "floor": floor_of[number], "links": links[number]}
            for number, photo in enumerate(tour.photos)
        ],
    }


def _floor(number: int, storey: Storey, picture: FloorPicture, origin: Array) -> dict[str, Any]:
    height, width = picture.pixels.shape[:2]
    return {
        "level": storey.level_m - float(origin[2]),
        "plan": _floor_file(number),
        "left": picture.left - float(origin[0]),
        "top": picture.top - float(origin[1]),
        "width": width / picture.pixels_per_m,
        "height": height / picture.pixels_per_m,
    }


def _photo(photo: PlacedPhoto, origin: Array) -> dict[str, Any]:
    taken = None if photo.time_unix_s is None else datetime.fromtimestamp(photo.time_unix_s, UTC)
    return {
        "name": display_name(photo.name),
        "taken": None if taken is None else taken.date().isoformat(),
        "position": (photo.map_from_camera.position - origin).tolist(),
        "rotation": photo.map_from_camera.rotation.tolist(),
        "model": photo.camera_model,
        "hfovDeg": photo.hfov_deg,
        "hasLarge": has_large(photo),
    }


def _floor_file(number: int) -> str:
    return f"walk/floor-{number}.webp"
