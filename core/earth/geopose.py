"""OGC GeoPose 1.0 (21-056r11), Basic-Quaternion: where a camera is on Earth, and how it is turned against east, north,
up there.

The body frame is that of all our cameras, x forward, y left, z up: the standard does not name one. Needs no numpy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from panoloc.core.earth.geodesy import (
    Position,
    Quaternion,
    ecef_from_enu,
    ecef_of,
    geodetic_of,
    inverse,
    times,
    turn,
    turned,
)
from panoloc.core.earth.georeference import coordinate_system

MEDIA_TYPE = "application/geopose+json"
Document = dict[str, dict[str, float]]


@dataclass(frozen=True)
class MapPose:
    """`map_from_camera` in the map's own axes, z up: metres, and degrees of Rz(yaw) · Ry(pitch) · Rx(roll)."""

    position_m: Position
    yaw_deg: float
    pitch_deg: float
    roll_deg: float


def geopose_of(georeference: Mapping[str, Any], pose: MapPose) -> Document | None:
    """Return the GeoPose of a camera; None where its height above the ellipsoid is not known, or outside of a
    coordinate system.

    georeference: `latitude_deg`, `longitude_deg`, `height_m`, `heading_deg` of the map's origin, as maps have it; or
    `coordinate_system`, of the map's positions, by EPSG code or WKT, and perhaps `geoid_undulation_m`, of the geoid
    above the ellipsoid.
    """
    of_map = times(times(turn("z", pose.yaw_deg), turn("y", pose.pitch_deg)), turn("x", pose.roll_deg))
    system = georeference.get("coordinate_system")
    if system is not None:
        found = coordinate_system(system).place(pose.position_m, georeference.get("geoid_undulation_m"))
        if found is None or found.height_reference != "ellipsoid":
            return None
        # The north of the grid is turned from true north by the convergence, as the y axis of a map by its heading.
        at = found.latitude_deg, found.longitude_deg, found.height_m
        return _document(at, times(turn("z", -found.convergence_deg), of_map))
    latitude, longitude = georeference["latitude_deg"], georeference["longitude_deg"]
    at_origin, heading = ecef_from_enu(latitude, longitude), turn("z", -georeference["heading_deg"])
    origin = ecef_of(latitude, longitude, georeference["height_m"])
    offset = turned(times(at_origin, heading), pose.position_m)
    at = geodetic_of((origin[0] + offset[0], origin[1] + offset[1], origin[2] + offset[2]))
    # East, north and up are those of the camera, which turn as it moves away from the origin.
    there = times(inverse(ecef_from_enu(at[0], at[1])), at_origin)
    return _document(at, times(times(there, heading), of_map))


def _document(at: Position, enu_from_camera: Quaternion) -> Document:
    sign = -1.0 if enu_from_camera[3] < 0 else 1.0
    return {
        "position": dict(zip(("lat", "lon", "h"), at, strict=True)),
        "quaternion": dict(zip("xyzw", (sign * value + 0.0 for value in enu_from_camera), strict=True)),
    }
