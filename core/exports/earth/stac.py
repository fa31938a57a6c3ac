"""STAC items with the Panorama extension 1.0.0, one per photo."""

import json
import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from core.exports.angles import PhotoAngles
from core.exports.axes import GL_FROM_FLU
from core.exports.earth.placing import on_earth, time_text
from core.exports.geodesy import EarthPose
from core.exports.tour import ExportedFile, PlacedPhoto, Tour

_EXTENSIONS = (
    "https://360-geo.github.io/stac-panorama/v1.0.0/schema.json",
    "https://stac-extensions.github.io/perspective-imagery/v1.0.0/schema.json",
    "https://stac-extensions.github.io/view/v1.1.0/schema.json",
)
_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".webp": "image/webp"}


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `items.json`, an item collection: a GeoJSON feature per photo, angles from true north, WGS 84.

    `datetime` of a photo without a time of its own is when it was placed.
    """
    items = [_item(tour, photo, place, angles) for photo, place, angles in on_earth(tour)]
    document = {"type": "FeatureCollection", "features": items}
    yield ExportedFile("items.json", (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def _item(tour: Tour, photo: PlacedPhoto, place: EarthPose, angles: PhotoAngles) -> dict[str, Any]:
    at = [place.longitude_deg, place.latitude_deg, place.height_m]
    media = _TYPES.get(PurePosixPath(photo.name).suffix.lower(), "application/octet-stream")
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(_EXTENSIONS),
        "id": re.sub(r"[^\w.-]", "_", photo.name),
        "geometry": {"type": "Point", "coordinates": at},
        "bbox": [*at, *at],
        "properties": {
            "datetime": time_text(tour, photo),
            "pano:projection_type": "equirectangular",
            "pano:yaw": angles.heading_deg,
            "pano:pitch": angles.elevation_deg,
            "pano:roll": angles.roll_deg,
            # Of longitude, latitude and height, which is what coordinates are where no `pers:crs` is named.
            "pers:perspective_center": at,
            "pers:rotation_matrix": (GL_FROM_FLU @ place.enu_from_camera.T).ravel().tolist(),
            "view:azimuth": angles.heading_deg,
        },
        "links": [],
        "assets": {"image": {"href": photo.name, "type": media, "roles": ["data"]}},
    }
