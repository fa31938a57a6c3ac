"""From a map to WGS 84: topocentric east, north, up at the map's origin, exact on the ellipsoid (EPSG method 9837)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.exports.tour import Georeference
from core.geometry.pose import Pose
from core.georeference import HeightReference

_SEMI_MAJOR_M = 6_378_137.0  # WGS 84
_FLATTENING = 1 / 298.257223563
_ECCENTRICITY_SQUARED = _FLATTENING * (2 - _FLATTENING)
_NUM_STEPS = 6  # of the height; each makes the error a few hundred times smaller


@dataclass(frozen=True)
class EarthPose:
    """A camera on Earth. height_m: above what height_reference says. enu_from_camera: (3, 3), east, north, up at the camera itself."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    enu_from_camera: NDArray[np.float64]
    height_reference: HeightReference = "ellipsoid"


def enu_from_map(georeference: Georeference) -> NDArray[np.float64]:
    """Return the rotation (3, 3) from the map's axes to east, north, up at its origin."""
    return turned_by(georeference.heading_deg)


def turned_by(heading_deg: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) to east, north, up from axes with z up whose y axis has this compass heading."""
    heading = math.radians(heading_deg)
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def earth_pose(georeference: Georeference, map_from_camera: Pose) -> EarthPose:
    """Return where a camera is on Earth. East, north and up are those of the camera, which turn as it moves away from the origin."""
    at_origin = ecef_from_enu(georeference.latitude_deg, georeference.longitude_deg)
    axes = enu_from_map(georeference)
    origin = ecef_of(georeference.latitude_deg, georeference.longitude_deg, georeference.height_m)
    latitude, longitude, height = geodetic_of(origin + at_origin @ axes @ map_from_camera.position)
    turn = ecef_from_enu(latitude, longitude).T @ at_origin
    return EarthPose(latitude, longitude, height, turn @ axes @ map_from_camera.rotation)


def ecef_of(latitude_deg: float, longitude_deg: float, height_m: float) -> NDArray[np.float64]:
    """Return the earth-centred position (3,) in metres of a place on WGS 84."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = _SEMI_MAJOR_M / math.sqrt(1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    across = (normal + height_m) * math.cos(latitude)
    along = (normal * (1 - _ECCENTRICITY_SQUARED) + height_m) * math.sin(latitude)
    return np.array([across * math.cos(longitude), across * math.sin(longitude), along])


def geodetic_of(ecef: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return latitude and longitude in degrees and the height above the ellipsoid in metres of an earth-centred position."""
    x, y, z = (float(value) for value in ecef)
    across = math.hypot(x, y)
    sine_part = z
    for _ in range(_NUM_STEPS):
        sine = sine_part / math.hypot(across, sine_part)
        normal = _SEMI_MAJOR_M / math.sqrt(1 - _ECCENTRICITY_SQUARED * sine * sine)
        sine_part = z + _ECCENTRICITY_SQUARED * normal * sine
    latitude = math.atan2(sine_part, across)
    height = math.hypot(across, sine_part) - normal
    return math.degrees(latitude), math.degrees(math.atan2(y, x)), height


def ecef_from_enu(latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) whose columns are east, north and up at a place."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    s, c, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
