"""A walk-through for a client: a folder whose `index.html` opens by a double click, without a service or a network.

Browsers let a page from a folder neither fetch its files nor read the pixels of its pictures. So whatever the page computes with
(`data.js`, photos for the sphere) is a script with the data in it; thumbnails and plans are plain pictures.
"""

import base64
import io
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from typing import Any

from PIL import Image, ImageOps

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.floor_plan import Array, FloorPicture, Points, Storey, draw_storey, points_of, storeys_of
from panoloc.core.exports.links import links_of
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour
from panoloc.core.scan.file_names import display_name

PAGE_FILES = {"index.html": "index.html", "page.js": "walk/page.js", "page.css": "walk/page.css"}
"""Of the built page, and where they lie in the export."""
_SMALL_PX, _MEDIUM_PX, _LARGE_PX = 320, 2048, 8192
"""Longer sides: of a thumbnail, of what is shown at once, of what follows. Graphics processors rarely take more."""
_QUALITIES = {_SMALL_PX: 70, _MEDIUM_PX: 80, _LARGE_PX: 85}
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
            for files in threads.map(_photo_files, range(first, first + len(group)), group):
                yield from files


def walk_document(
    tour: Tour, storeys: Sequence[Storey], pictures: Sequence[FloorPicture], points: Points
) -> dict[str, Any]:
    """Return what the page knows of the tour; `walk_data.ts` of the console says the same in TypeScript.

    Positions are metres from `origin`, because graphics processors compute in single precision. Rotations have rows, from camera (x
    forward, y left, z up) to map.
    """
    origin = tour.offset_m
    floor_of = {number: floor for floor, storey in enumerate(storeys) for number in storey.photos}
    links = links_of(tour.positions, points.positions)
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
        "hasLarge": _has_large(photo),
    }


def _floor_file(number: int) -> str:
    return f"walk/floor-{number}.webp"


def _has_large(photo: PlacedPhoto) -> bool:
    """Tell whether a photo has more pixels than the size in the middle."""
    return max(photo.width, photo.height) > _MEDIUM_PX


def _photo_files(number: int, photo: PlacedPhoto) -> list[ExportedFile]:
    """Return a photo as `NUMBER-small.jpg`, `-medium.js` and, where it has more pixels, `-large.js`; none has its EXIF data.

    Raises OSError.
    """
    assert photo.image is not None
    with Image.open(photo.image) as opened:
        shown = ImageOps.exif_transpose(opened).convert("RGB")
    files = []
    if _has_large(photo):
        files.append(_script(number, "large", _shrunk(shown, _LARGE_PX)))
    files.append(_script(number, "medium", _shrunk(shown, _MEDIUM_PX)))
    return [*files, ExportedFile(f"walk/photos/{number}-small.jpg", _shrunk(shown, _SMALL_PX))]


def _shrunk(picture: Image.Image, size: int) -> bytes:
    """Make a picture as small as a size, if it is larger, and return it as a JPEG."""
    picture.thumbnail((size, size), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=_QUALITIES[size], optimize=True, progressive=size != _SMALL_PX)
    return out.getvalue()


def _script(number: int, size: str, jpeg: bytes) -> ExportedFile:
    """Return a photo as a script: a page from a folder may show a picture beside it, but not read its pixels."""
    name, data = f"{number}-{size}", base64.b64encode(jpeg).decode()
    script = f'panolocPhoto("{name}", "data:image/jpeg;base64,{data}");\n'
    return ExportedFile(f"walk/photos/{name}.js", script.encode())
