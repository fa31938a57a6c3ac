"""A tour as JSON: the input of the process that writes exports. Sizes and times are read from the photos.

{"name": "map_…", "created_unix_s": 0, "georeference": null | {…}, "coordinate_system": null | "EPSG:25832",
     "geoid_undulation_m": null | 46.2, "scan": null | "points.ply", "survey": null | "scan.e57",
 "photos": [{"name": "a.jpg", "image": "/…/00000", "frame": "ros", "position_m": [x, y, z], "quaternion_xyzw": [x, y, z, w],
             "camera_model": "equirectangular", "confidence": 0.9, "position_radius_m": 0.02, "orientation_radius_deg": 0.3}],
 "left_out": [{"name": "b.jpg", "reason": "not_localized"}]}
"""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from PIL import Image

from panoloc.core.exports.tour import Georeference, LeftOut, PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose

_EXIF_IFD, _TAKEN, _TAKEN_OFFSET, _TAKEN_FRACTION, _ORIENTATION = 0x8769, 0x9003, 0x9011, 0x9291, 0x0112
_ON_ITS_SIDE = (5, 6, 7, 8)


def read_tour(path: Path) -> Tour:
    """Return the tour that a file describes. Raises OSError for photos that cannot be opened."""
    document = json.loads(path.read_text(encoding="utf-8"))
    place = document["georeference"]
    return Tour(
        name=document["name"],
        photos=tuple(_photo(each) for each in document["photos"]),
        left_out=tuple(LeftOut(**each) for each in document["left_out"]),
        georeference=None if place is None else Georeference(**place),
        coordinate_system=document["coordinate_system"],
        created_unix_s=document["created_unix_s"],
        scan=_path(document["scan"]),
        survey=_path(document["survey"]),
        geoid_undulation_m=document["geoid_undulation_m"],
    )


def _path(given: str | None) -> Path | None:
    return None if given is None else Path(given)


def _photo(given: dict[str, Any]) -> PlacedPhoto:
    image = Path(given["image"])
    # More pixels than Pillow likes were accepted when the photo was placed; nothing is decoded here.
    Image.MAX_IMAGE_PIXELS = None
    with Image.open(image) as opened:
        exif = opened.getexif()
        width, height = opened.size
        time_unix_s = _time_taken(exif.get_ifd(_EXIF_IFD))
    if exif.get(_ORIENTATION) in _ON_ITS_SIDE:
        width, height = height, width
    return PlacedPhoto(
        name=given["name"],
        map_from_camera=Pose.from_frame(given["position_m"], given["quaternion_xyzw"], given["frame"]),
        width=width,
        height=height,
        is_sphere=given["camera_model"] == "equirectangular" and width == 2 * height,
        time_unix_s=time_unix_s,
        confidence=given["confidence"],
        position_radius_m=given["position_radius_m"],
        orientation_radius_deg=given["orientation_radius_deg"],
        image=image,
    )


def _time_taken(exif: dict[int, Any]) -> float | None:
    """Return when a photo was taken in Unix seconds, None where unknown. A clock without an offset counts as UTC."""
    text, offset = str(exif.get(_TAKEN, "")), str(exif.get(_TAKEN_OFFSET, "")).strip("\x00 ")
    try:
        taken = datetime.strptime(text.strip("\x00 ") + (offset or "+00:00"), "%Y:%m:%d %H:%M:%S%z")
        fraction = float(f"0.{str(exif.get(_TAKEN_FRACTION, '')).strip(chr(0) + ' ') or 0}")
    except ValueError:
        return None
    return taken.astimezone(UTC).timestamp() + fraction
