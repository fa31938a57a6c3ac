"""Placed photos on Earth, for the formats that need a georeference."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.angles import PhotoAngles, photo_angles
from panoloc.core.exports.geodesy import EarthPose, earth_pose, turned_by
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.georeference import coordinate_system

_EPSG = re.compile(r"(?i)epsg:(\d+)")


def on_earth(tour: Tour) -> Iterator[tuple[PlacedPhoto, EarthPose, PhotoAngles]]:
    """Yield each photo with its place and its angles from true north, both at the camera.

    Raises ExportRefusedError for a photo outside of where the map's coordinate system is defined.
    """
    for photo in tour.photos:
        place = _place(tour, photo)
        yield photo, place, photo_angles(place.enu_from_camera)


def grid_of(tour: Tour) -> int | None:
    """Return the EPSG code of the map's own axes, None without one or where its unit is not the metre."""
    if tour.georeference is not None or tour.coordinate_system is None:
        return None
    code = _EPSG.match(tour.coordinate_system)
    if code is None or coordinate_system(tour.coordinate_system).metres_per_unit != 1.0:
        return None
    return int(code[1])


def coordinates(place: EarthPose) -> list[float]:
    """Return longitude and latitude, and the height where it is above the ellipsoid, as GeoJSON counts heights."""
    at = [place.longitude_deg, place.latitude_deg]
    return [*at, place.height_m] if place.height_reference == "ellipsoid" else at


def _place(tour: Tour, photo: PlacedPhoto) -> EarthPose:
    pose = photo.map_from_camera
    if tour.georeference is not None:
        return earth_pose(tour.georeference, pose)
    assert tour.coordinate_system is not None, "the registry of formats refuses maps without either"
    x, y, z = pose.position.tolist()
    found = coordinate_system(tour.coordinate_system).place((x, y, z), tour.geoid_undulation_m)
    if found is None:
        raise ExportRefusedError(
            f"expected positions inside {tour.coordinate_system[:60]}, got {photo.name} at {x:.1f}, {y:.1f}, "
            "which is outside; correct the coordinate system of the map"
        )
    # The north of the grid is turned from true north by the convergence, as the y axis of a map by its heading.
    enu_from_camera = turned_by(found.convergence_deg) @ pose.rotation
    return EarthPose(found.latitude_deg, found.longitude_deg, found.height_m, enu_from_camera, found.height_reference)


def time_text(tour: Tour, photo: PlacedPhoto) -> str:
    """Return when a photo was taken, or else placed, as RFC 3339 in UTC."""
    time_unix_s = tour.created_unix_s if photo.time_unix_s is None else photo.time_unix_s
    return datetime.fromtimestamp(time_unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
