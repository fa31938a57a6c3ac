"""From a map to WGS 84: topocentric east, north, up at the map's origin, exact on the ellipsoid (EPSG method 9837)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core import geodesy
from panoloc.core.exports.tour import Georeference
from panoloc.core.geometry.pose import Pose
from panoloc.core.georeference import HeightReference


@dataclass(frozen=True)
class EarthPose:
    """A camera on Earth. height_m: above height_reference. enu_from_camera: (3, 3), east, north, up at the camera."""

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
    """Return where a camera is on Earth. East, north and up are those at the camera, not at the map's origin."""
    at_origin = ecef_from_enu(georeference.latitude_deg, georeference.longitude_deg)
    axes = enu_from_map(georeference)
    origin = ecef_of(georeference.latitude_deg, georeference.longitude_deg, georeference.height_m)
    x, y, z = (origin + at_origin @ axes @ map_from_camera.position).tolist()
    latitude, longitude, height = geodesy.geodetic_of((x, y, z))
    turn = ecef_from_enu(latitude, longitude).T @ at_origin
    return EarthPose(latitude, longitude, height, turn @ axes @ map_from_camera.rotation)


def ecef_of(latitude_deg: float, longitude_deg: float, height_m: float) -> NDArray[np.float64]:
    """Return the earth-centred position (3,) in metres of a place on WGS 84."""
    return np.array(geodesy.ecef_of(latitude_deg, longitude_deg, height_m))


def ecef_from_enu(latitude_deg: float, longitude_deg: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) whose columns are east, north and up at a place."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    s, c, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
