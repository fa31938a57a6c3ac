"""Formats of geographic systems: ArcGIS, STAC, GeoJSON. All need a map with a georeference or a coordinate system."""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import PurePosixPath
from typing import Any

from panoloc.core.earth.geopose import EarthPose, earth_pose, grid_pose
from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.frames import GL_FROM_FLU, PhotoAngles, photo_angles
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, json_file, plain
from panoloc.core.scan.file_names import distinct_names

_WGS84 = 4326
_MAX_ARCGIS_ROLL_DEG = 90.0
_OFFSETS_H = (-12, 14)  # of local times from UTC
_ARCGIS_COLUMNS = (
    *("X", "Y", "Z", "SRS", "Name", "ImagePath", "AcquisitionDate", "CameraHeading", "CameraPitch", "CameraRoll"),
    *("HorizontalFieldOfView", "VerticalFieldOfView", "OrientedImageryType"),
)
_STAC_EXTENSIONS = (
    "https://360-geo.github.io/stac-panorama/v1.0.0/schema.json",
    "https://stac-extensions.github.io/perspective-imagery/v1.0.0/schema.json",
    "https://stac-extensions.github.io/view/v1.1.0/schema.json",
)
_MEDIA_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".webp": "image/webp"}


def why_not_in_arcgis(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can. The turn of a map about its vertical changes no roll."""
    roll_deg = photo_angles(photo.map_from_camera.rotation).roll_deg
    if abs(roll_deg) <= _MAX_ARCGIS_ROLL_DEG:
        return None
    return f"its roll is {roll_deg:.0f} degrees; ArcGIS takes at most {_MAX_ARCGIS_ROLL_DEG:g} to either side"


def write_arcgis(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `oriented_imagery.csv`: positions and headings in the map's grid, else in WGS 84 and from true north.

    Its pitch is 0 straight down, 90 at the horizon: 90 + elevation.
    """
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(_ARCGIS_COLUMNS)
    grid = grid_of(tour)
    for photo, place, true_angles in on_earth(tour):
        angles = true_angles if grid is None else photo_angles(photo.map_from_camera.rotation)
        on_globe = [place.longitude_deg, place.latitude_deg, place.height_m]
        position = on_globe if grid is None else photo.map_from_camera.position.tolist()
        named = [str(grid or _WGS84), photo.name, photo.name, _time_text(photo)]
        turns = angles.heading_deg, 90.0 + angles.elevation_deg, angles.roll_deg
        table.writerow([*(plain(value, 12) for value in position), *named, *map(plain, turns), "360", "180", "360"])
    yield ExportedFile("oriented_imagery.csv", out.getvalue().encode())


def write_stac(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `items.json`, STAC items with the Panorama extension 1.0.0: a GeoJSON feature per photo.

    Angles and centre of projection are in the grid of a map that has one (`pers:crs`), else WGS 84 and from true north.
    `datetime` of a photo without a time of its own is when it was placed. It is null for a clock that does not name its offset: the time
    then lies in an interval of 26 hours.
    """
    ids = distinct_names(re.sub(r"[^\w.-]", "_", photo.name) for photo in tour.photos)
    placed = zip(ids, on_earth(tour), strict=True)
    items = [_stac_item(tour, item_id, photo, place, angles) for item_id, (photo, place, angles) in placed]
    yield json_file("items.json", {"type": "FeatureCollection", "features": items})


def _stac_item(tour: Tour, item_id: str, photo: PlacedPhoto, place: EarthPose, angles: PhotoAngles) -> dict[str, Any]:
    at = _coordinates(place)
    grid, pose = grid_of(tour), photo.map_from_camera
    rotation = place.enu_from_camera if grid is None else pose.rotation
    shown = angles if grid is None else photo_angles(pose.rotation)
    media = _MEDIA_TYPES.get(PurePosixPath(photo.name).suffix.lower(), "application/octet-stream")
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": list(_STAC_EXTENSIONS),
        "id": item_id,
        "geometry": {"type": "Point", "coordinates": at},
        "bbox": [*at, *at],
        "properties": {
            **_stac_time(tour, photo),
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


def write_geojson(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `photos.geojson` (RFC 7946), a point per photo: longitude, latitude, height where it is above the ellipsoid.

    Angles are from true north, elevation up, right side down.
    """
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": _coordinates(place)},
            "properties": {
                "name": photo.name,
                "time": _time_text(photo) or None,
                **asdict(angles),
                "north": "true",
                "height_m": place.height_m,
                "height_reference": place.height_reference,
                "confidence": photo.confidence,
            },
        }
        for photo, place, angles in on_earth(tour)
    ]
    yield json_file("photos.geojson", {"type": "FeatureCollection", "features": features})


def on_earth(tour: Tour) -> Iterator[tuple[PlacedPhoto, EarthPose, PhotoAngles]]:
    """Yield each photo with its place and its angles from true north, both at the camera.

    Raises ExportRefusedError for a photo outside of where the map's coordinate system is defined.
    """
    for photo in tour.photos:
        place = _place(tour, photo)
        yield photo, place, photo_angles(place.enu_from_camera)


def grid_of(tour: Tour) -> int | None:
    """Return the EPSG code of the map's horizontal axes, None without one or where their unit is not the metre."""
    if tour.georeference is not None or tour.coordinate_system is None:
        return None
    system = coordinate_system(tour.coordinate_system)
    return system.epsg if system.metres_per_unit == 1.0 else None


def _coordinates(place: EarthPose) -> list[float]:
    """Return longitude and latitude, and the height where it is above the ellipsoid, as GeoJSON counts heights."""
    at = [place.longitude_deg, place.latitude_deg]
    return [*at, place.height_m] if place.height_reference == "ellipsoid" else at


def _place(tour: Tour, photo: PlacedPhoto) -> EarthPose:
    pose = photo.map_from_camera
    if tour.georeference is not None:
        return earth_pose(tour.georeference, pose)
    assert tour.coordinate_system is not None, "the registry of formats refuses maps without either"
    found = grid_pose(tour.coordinate_system, tour.geoid_undulation_m, pose)
    if found is None:
        x, y, _ = pose.position.tolist()
        raise ExportRefusedError(
            f"expected positions inside {tour.coordinate_system[:60]}, got {photo.name} at {x:.1f}, {y:.1f}, "
            "which is outside; correct the coordinate system of the map"
        )
    return found


def _stac_time(tour: Tour, photo: PlacedPhoto) -> dict[str, str | None]:
    if photo.time_unix_s is None or not photo.is_local_time:
        return {"datetime": _time_text(photo) or _text_of(tour.created_unix_s)}
    bounds = (_text_of(photo.time_unix_s - 3600 * ahead) for ahead in _OFFSETS_H)
    return {"datetime": None, **dict(zip(("end_datetime", "start_datetime"), bounds, strict=True))}


def _time_text(photo: PlacedPhoto) -> str:
    """Return when a photo was taken as RFC 3339 in UTC, without the Z where it is local time (ISO 8601); empty if that is not known."""
    if photo.time_unix_s is None:
        return ""
    text = _text_of(photo.time_unix_s)
    return text.removesuffix("Z") if photo.is_local_time else text


def _text_of(time_unix_s: float) -> str:
    return datetime.fromtimestamp(time_unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
