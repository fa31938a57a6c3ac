"""GeoJSON (RFC 7946): a point per photo."""

from collections.abc import Iterator

from panoloc.core.exports.earth.placing import coordinates, on_earth, time_text
from panoloc.core.exports.tour import ExportedFile, Tour, json_file


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `photos.geojson`: longitude, latitude, height where it is above the ellipsoid; angles
    from true north, elevation up, right side down."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": coordinates(place)},
            "properties": {
                "name": photo.name,
                "time": None if photo.time_unix_s is None else time_text(tour, photo),
                "heading_deg": angles.heading_deg,
                "elevation_deg": angles.elevation_deg,
                "roll_deg": angles.roll_deg,
                "north": "true",
                "height_m": place.height_m,
                "height_reference": place.height_reference,
                "confidence": photo.confidence,
            },
        }
        for photo, place, angles in on_earth(tour)
    ]
    yield json_file("photos.geojson", {"type": "FeatureCollection", "features": features})
