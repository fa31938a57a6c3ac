"""WGS 84: geodetic and earth-centred positions by pyproj, and turns between local axes as quaternions."""

import math
from functools import lru_cache
from typing import Any

Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w (Hamilton), of unit length."""


@lru_cache
def _ecef_from_geodetic() -> Any:
    from pyproj import Transformer

    return Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def ecef_of(latitude_deg: float, longitude_deg: float, height_m: float) -> Position:
    """Return the earth-centred position in metres of a place. height_m: above the ellipsoid."""
    x, y, z = _ecef_from_geodetic().transform(longitude_deg, latitude_deg, height_m)
    return x, y, z


def geodetic_of(ecef: Position) -> Position:
    """Return latitude and longitude in degrees and the height above the ellipsoid in metres of an earth-centred
    position."""
    longitude, latitude, height = _ecef_from_geodetic().transform(*ecef, direction="INVERSE")
    return latitude, longitude, height


def ecef_from_enu(latitude_deg: float, longitude_deg: float) -> Quaternion:
    """Return the turn from axes east, north, up at a place to earth-centred ones."""
    return times(turn("z", longitude_deg + 90.0), turn("x", 90.0 - latitude_deg))


def turn(axis: str, angle_deg: float) -> Quaternion:
    """Return a right-handed turn about one of x, y and z."""
    half = math.radians(angle_deg) / 2
    x, y, z = (math.sin(half) if axis == name else 0.0 for name in "xyz")
    return x, y, z, math.cos(half)


def times(after: Quaternion, first: Quaternion) -> Quaternion:
    """Return the turn `first`, followed by `after`."""
    ax, ay, az, aw = after
    bx, by, bz, bw = first
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(of: Quaternion) -> Quaternion:
    """Return the turn back."""
    x, y, z, w = of
    return -x, -y, -z, w


def turned(by: Quaternion, position: Position) -> Position:
    """Return a position after a turn."""
    x, y, z, _ = times(times(by, (*position, 0.0)), inverse(by))
    return x, y, z
