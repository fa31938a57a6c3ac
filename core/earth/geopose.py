"""Cameras on Earth: where they are on WGS 84, and how they are turned against east, north, up there.

OGC GeoPose 1.0 (21-056r11), Basic-Quaternion, is one way to write it. The body frame is that of all our cameras, x forward, y left,
z up: the standard does not name one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.earth.georeference import HeightReference, coordinate_system, ecef_of, geodetic_of
from panoloc.core.geometry.pose import Pose, quaternion_of

Document = dict[str, dict[str, float]]
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Georeference:
    """Where a map lies on Earth: WGS 84, its origin's height above the ellipsoid, the compass heading of its y axis."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    heading_deg: float


@dataclass(frozen=True)
class EarthPose:
    """A camera on Earth. height_m: above height_reference. enu_from_camera: (3, 3), east, north, up at the camera."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    enu_from_camera: Matrix
    height_reference: HeightReference = "ellipsoid"


def geopose_of(georeference: Mapping[str, Any], map_from_camera: Pose) -> Document | None:
    """Return the GeoPose of a camera; None where its height above the ellipsoid is not known, or outside of a
    coordinate system.

    georeference: fields of `Georeference`, as maps have it; or `coordinate_system`, of the map's positions, by EPSG code
    or WKT, and perhaps `geoid_undulation_m`, of the geoid above the ellipsoid.
    """
    system = georeference.get("coordinate_system")
    if system is None:
        found: EarthPose | None = earth_pose(Georeference(**georeference), map_from_camera)
    else:
        found = grid_pose(system, georeference.get("geoid_undulation_m"), map_from_camera)
    if found is None or found.height_reference != "ellipsoid":
        return None
    at = found.latitude_deg, found.longitude_deg, found.height_m
    turned = (quaternion_of(found.enu_from_camera) + 0.0).tolist()  # no zero is negative
    return {
        "position": dict(zip(("lat", "lon", "h"), at, strict=True)),
        "quaternion": dict(zip("xyzw", turned, strict=True)),
    }


def grid_pose(system: str, geoid_undulation_m: float | None, map_from_camera: Pose) -> EarthPose | None:
    """Return where a camera is on Earth whose map is in a coordinate system; None outside of where that is defined."""
    x, y, z = map_from_camera.position.tolist()
    found = coordinate_system(system).place((x, y, z), geoid_undulation_m)
    if found is None:
        return None
    # The north of the grid is turned from true north by the convergence, as the y axis of a map by its heading.
    turned = turned_by(found.convergence_deg) @ map_from_camera.rotation
    return EarthPose(found.latitude_deg, found.longitude_deg, found.height_m, turned, found.height_reference)


def seen_from(origin: EarthPose, camera: EarthPose) -> Pose:
    """Return the pose of a camera in east, north, up at an origin whose height counts from the same reference."""
    axes = ecef_from_enu(origin.latitude_deg, origin.longitude_deg)
    there, here = (np.array(ecef_of(at.latitude_deg, at.longitude_deg, at.height_m)) for at in (camera, origin))
    turn = axes.T @ ecef_from_enu(camera.latitude_deg, camera.longitude_deg)
    return Pose(turn @ camera.enu_from_camera, axes.T @ (there - here))


def turned_by(heading_deg: float) -> Matrix:
    """Return the rotation (3, 3) to east, north, up from axes with z up whose y axis has this compass heading."""
    heading = math.radians(heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def earth_pose(georeference: Georeference, map_from_camera: Pose) -> EarthPose:
    """Return where a camera is on Earth: topocentric at the map's origin, exact on the ellipsoid (EPSG method 9837).

    East, north and up are those at the camera, not at the map's origin.
    """
    place, axes = georeference, turned_by(georeference.heading_deg)
    at_origin = ecef_from_enu(place.latitude_deg, place.longitude_deg)
    origin = np.array(ecef_of(place.latitude_deg, place.longitude_deg, place.height_m))
    x, y, z = (origin + at_origin @ axes @ map_from_camera.position).tolist()
    latitude, longitude, height = geodetic_of((x, y, z))
    turn = ecef_from_enu(latitude, longitude).T @ at_origin
    return EarthPose(latitude, longitude, height, turn @ axes @ map_from_camera.rotation)


def ecef_from_enu(latitude_deg: float, longitude_deg: float) -> Matrix:
    """Return the rotation (3, 3) whose columns are east, north and up at a place."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    s, c, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
