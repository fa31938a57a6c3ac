"""STAC items with the Panorama extension 1.0.0, one per photo."""

import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from panoloc.core.distinct_names import distinct_names
from panoloc.core.exports.angles import PhotoAngles, photo_angles
from panoloc.core.exports.axes import GL_FROM_FLU
from panoloc.core.exports.earth.placing import coordinates, grid_of, on_earth, time_text
from panoloc.core.exports.geodesy import EarthPose
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file

_EXTENSIONS = (
    "https://360-geo.github.io/stac-panorama/v1.0.0/schema.json",
    "https://stac-extensions.github.io/perspective-imagery/v1.0.0/schema.json",
    "https://stac-extensions.github.io/view/v1.1.0/schema.json",
)
_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".webp": "image/webp"}


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `items.json`, an item collection: a GeoJSON feature per photo.

    Angles and centre of projection are in the grid of a map that has one (`pers:crs`), else WGS 84 and from true north.

    `datetime` of a photo without a time of its own is when it was placed.
    """
    ids = distinct_names(re.sub(r"[^\w.-]", "_", photo.name) for photo in tour.photos)
    placed = zip(ids, on_earth(tour), strict=True)
    items = [_item(tour, item_id, photo, place, angles) for item_id, (photo, place, angles) in placed]
    yield json_file("items.json", {"type": "FeatureCollection", "features": items})


def _item(tour: Tour, item_id: str, photo: PlacedPhoto, place: EarthPose, angles: PhotoAngles) -> dict[str, Any]:
    at = coordinates(place)
    grid, pose = grid_of(tour), photo.map_from_camera
    rotation = place.enu_from_camera if grid is None else pose.rotation
    shown = angles if grid is None else photo_angles(pose.rotation)
    media = _TYPES.get(PurePosixPath(photo.name).suffix.lower(), "application/octet-stream")
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(_EXTENSIONS),
        "id": item_id,
        "geometry": {"type": "Point", "coordinates": at},
        "bbox": [*at, *at],
        "properties": {
            "datetime": time_text(tour, photo),
            "pano:projection_type": "equirectangular",
            "pano:yaw": shown.heading_deg,
            "pano:pitch": shown.elevation_deg,
            "pano:roll": shown.roll_deg,
            **({} if grid is None else {"pers:crs": grid}),
            # Without `pers:crs`: longitude, latitude and height.
            "pers:perspective_center": [*at[:2], place.height_m] if grid is None else pose.position.tolist(),
            "pers:rotation_matrix": (GL_FROM_FLU @ rotation.T).ravel().tolist(),
            "view:azimuth": angles.heading_deg,
        },
        "links": [],
        "assets": {"image": {"href": photo.name, "type": media, "roles": ["data"]}},
    }
