"""WGS 84 in plain numbers: geodetic and earth-centred positions, and turns between local axes, as quaternions. Needs no numpy."""

import math

Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""x, y, z, w (Hamilton), of unit length."""

_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563
_ECCENTRICITY_SQUARED = _FLATTENING * (2 - _FLATTENING)
_NUM_STEPS = 6  # of the height; each makes the error a few hundred times smaller


def ecef_of(latitude_deg: float, longitude_deg: float, height_m: float) -> Position:
    """Return the earth-centred position in metres of a place. height_m: above the ellipsoid."""
    latitude, longitude = math.radians(latitude_deg), math.radians(longitude_deg)
    normal = _SEMI_MAJOR_M / math.sqrt(1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    across = (normal + height_m) * math.cos(latitude)
    along = (normal * (1 - _ECCENTRICITY_SQUARED) + height_m) * math.sin(latitude)
    return across * math.cos(longitude), across * math.sin(longitude), along


def geodetic_of(ecef: Position) -> Position:
    """Return latitude and longitude in degrees and the height above the ellipsoid in metres of an earth-centred position."""
    x, y, z = ecef
    across = math.hypot(x, y)
    sine_part, normal = z, _SEMI_MAJOR_M
    for _ in range(_NUM_STEPS):
        sine = sine_part / math.hypot(across, sine_part)
        normal = _SEMI_MAJOR_M / math.sqrt(1 - _ECCENTRICITY_SQUARED * sine * sine)
        sine_part = z + _ECCENTRICITY_SQUARED * normal * sine
    latitude = math.atan2(sine_part, across)
    return math.degrees(latitude), math.degrees(math.atan2(y, x)), math.hypot(across, sine_part) - normal


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
