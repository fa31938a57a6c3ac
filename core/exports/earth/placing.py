"""Placed photos on Earth, for the formats that need a georeference."""

from collections.abc import Iterator
from datetime import UTC, datetime

from core.exports.angles import PhotoAngles, photo_angles
from core.exports.geodesy import EarthPose, earth_pose
from core.exports.tour import PlacedPhoto, Tour


def on_earth(tour: Tour) -> Iterator[tuple[PlacedPhoto, EarthPose, PhotoAngles]]:
    """Yield each photo with its place and its angles from true north, both at the camera."""
    assert tour.georeference is not None, "the registry of formats refuses maps without one"
    for photo in tour.photos:
        place = earth_pose(tour.georeference, photo.map_from_camera)
        yield photo, place, photo_angles(place.enu_from_camera)


def time_text(tour: Tour, photo: PlacedPhoto) -> str:
    """Return when a photo was taken, or placed where nobody knows, as RFC 3339 in UTC."""
    time_unix_s = tour.created_unix_s if photo.time_unix_s is None else photo.time_unix_s
    return datetime.fromtimestamp(time_unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
