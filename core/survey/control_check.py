"""Checks a map against control points: as it stands on Earth, and after the best levelled fit, which gives it a place there."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.earth.geopose import EarthPose, Georeference, earth_pose, ecef_from_enu
from panoloc.core.earth.georeference import (
    CoordinateSystem,
    EarthPlace,
    HeightReference,
    coordinate_system,
    ecef_of,
    geodetic_of,
)
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.survey.control_csv import ControlPoint
from panoloc.core.survey.control_fit import EXCHANGED, UNITS, LevelFit, fit_level

Array = NDArray[np.float64]
_FARTHEST_M = 20_000.0  # of points from the origin of a map that a plane stands for
_ROUNDS = 4  # until the plane is that at the map's origin
_MOST_TILT_DEG = 0.5
_MOST_SCALE_M = 0.06  # three times what clicks are off
_BLUNDER_M = 0.05
_FALSE_ALARMS = 0.01  # of lists without a wrong point
_UNKNOWNS = 4  # of a levelled fit
_SAME_HEIGHT = "the heights of the points and of the map are above different surfaces"


@dataclass(frozen=True)
class ControlCheck:
    """What control points say of a map; arrays are of the points that have a place in the map, in their order.

    is_on_earth: whether the coordinates are on Earth; else they are of no system, such as a site's. as_is: (n, 3) to the east, north and
    up, metres, where the map puts a point minus where it is known to be; None for a map without a place. fit: None where `no_fit` says why.
    georeference: by the fit, None where `no_georeference` says why. suspect: name of the point that is wrong, as far as the others tell.
    warnings: in words.
    """

    is_on_earth: bool
    as_is: Array | None
    fit: LevelFit | None
    no_fit: str | None
    georeference: Georeference | None
    no_georeference: str | None
    suspect: str | None
    warnings: tuple[str, ...]


def check_control(
    points: Sequence[ControlPoint], system: str | None, undulation_m: float | None, place: Mapping[str, Any]
) -> ControlCheck:
    """Compare the points that have a place in the map.

    system: of x and y of the points, by EPSG code or WKT; None: that of the map, or none at all. undulation_m: of the geoid above the
    ellipsoid. place: `georeference`, `coordinate_system` and `geoid_undulation_m` of the map, each may be None. Raises OptionsError for
    coordinates that are not in the system.
    """
    used = [point for point in points if point.position_m is not None]
    positions = np.array([point.position_m for point in used], np.float64).reshape(-1, 3)
    system = system or place.get("coordinate_system")
    is_on_earth = any(point.is_geodetic for point in used) or system is not None
    if not is_on_earth:
        return _local(positions, used, place)
    undulation_m = place.get("geoid_undulation_m") if undulation_m is None else undulation_m
    grid = coordinate_system(system) if system is not None else None
    try:
        on_earth = [_on_earth(point, grid, undulation_m) for point in used]
    except OptionsError as error:
        raise _explained(error, used, grid, undulation_m) from None
    ecef, heights = np.array([each for each, _ in on_earth], np.float64).reshape(-1, 3), {each for _, each in on_earth}
    measured, map_heights = _measured(positions, place, undulation_m)
    warnings = []
    if measured is not None and len(heights | {map_heights}) > 1:
        warnings.append(
            f"{_SAME_HEIGHT}, so the differences upwards say little; state the height of the geoid above the ellipsoid (geoid_undulation_m)"
        )
    as_is = None
    if measured is not None and len(ecef):
        as_is = (measured - ecef) @ _axes_at(ecef.mean(axis=0))
    try:
        fit, georeference = _fit_on_earth(positions, ecef, [point.name for point in used])
    except OptionsError as error:
        words = str(_explained(error, used, grid, undulation_m))
        return ControlCheck(True, as_is, None, words, None, words, None, tuple(warnings))
    why = None
    if georeference is None and as_is is not None and place.get("coordinate_system") is not None:
        why = (
            f"the map's positions are coordinates of {coordinate_system(place['coordinate_system']).name} already, so there is "
            "nothing to apply; the residuals as the map stands say how well it fits"
        )
    elif georeference is None:
        away_km = np.linalg.norm(positions.mean(axis=0)) / 1000
        why = (
            f"the points lie {away_km:.0f} km from the map's origin, so its positions are coordinates of a grid; set the map's "
            "coordinate_system instead"
        )
    elif heights != {"ellipsoid"}:
        georeference = None
        why = (
            "a georeference has a height above the ellipsoid, and those of the points are not known to be one; "
            "state how high the geoid is above it (geoid_undulation_m), or send heights above the ellipsoid"
        )
    return ControlCheck(True, as_is, fit, None, georeference, why, *_doubts(fit, used, warnings))


def _local(positions: Array, used: Sequence[ControlPoint], place: Mapping[str, Any]) -> ControlCheck:
    """Compare with coordinates of no system on Earth: they are those of the map itself, or a site's own."""
    known = np.array([point.known for point in used], np.float64).reshape(-1, 3)
    why = "the points have no coordinate system; name one, or send latitudes and longitudes"
    as_is = positions - known if place.get("georeference") is None else None
    try:
        fit = fit_level(positions, known, [point.name for point in used])
    except OptionsError as error:
        return ControlCheck(False, as_is, None, str(error), None, str(error), None, ())
    away_km = np.linalg.norm((known - positions).mean(axis=0)) / 1000
    far = f"the points lie {away_km:,.0f} km from where the scan has them: name their coordinate system, or check their unit"
    return ControlCheck(
        False, as_is, fit, None, None, why, *_doubts(fit, used, [far] if 1000 * away_km > _FARTHEST_M else [])
    )


def _explained(
    error: OptionsError, used: Sequence[ControlPoint], grid: CoordinateSystem | None, undulation_m: float | None
) -> OptionsError:
    """Return an error that says how coordinates of a grid were meant, if the points fit so; else the one that came up.

    It is tried in the grid: misread coordinates lie elsewhere on Earth, where the grid is distorted.
    """
    if grid is None or any(point.is_geodetic for point in used):
        return error
    positions = np.array([point.position_m for point in used], np.float64).reshape(-1, 3)
    known = np.array([point.known for point in used], np.float64).reshape(-1, 3)
    meant = {EXCHANGED: known[:, [1, 0, 2]]}
    meant |= {f"read as {unit} they fit: send them in metres": known * metres for metres, unit in UNITS.items()}
    for words, read in meant.items():
        try:
            each = zip(used, read.tolist(), strict=True)
            found = [_on_earth(replace(point, known=(x, y, z)), grid, undulation_m)[0] for point, (x, y, z) in each]
            _fit_on_earth(positions, np.array(found).reshape(-1, 3), [point.name for point in used])
        except OptionsError:
            continue
        return OptionsError(
            f"points: expected coordinates in {grid.name}, east before north and in metres, got others; {words}"
        )
    return error


def _on_earth(
    point: ControlPoint, grid: CoordinateSystem | None, undulation_m: float | None
) -> tuple[tuple[float, float, float], HeightReference]:
    """Return the earth-centred position of a point, and what its height is above."""
    if point.is_geodetic:
        return ecef_of(*point.known), "ellipsoid"
    if grid is None:
        raise OptionsError(
            f"coordinate_system: expected one for {point.name}, which has x and y beside points with latitudes; name it, or send latitudes"
        )
    found = grid.place(point.known, undulation_m)
    if found is None:
        raise OptionsError(
            f"points: expected coordinates within {grid.name}, got {point.known[0]:.1f}, {point.known[1]:.1f} for {point.name}"
            f"{grid.how_inside(point.known)}; check the system, the unit, and whether x is east"
        )
    return ecef_of(found.latitude_deg, found.longitude_deg, found.height_m), found.height_reference


def _measured(
    positions: Array, place: Mapping[str, Any], undulation_m: float | None
) -> tuple[Array | None, HeightReference]:
    """Return where the map puts positions on Earth (n, 3), and what its heights are above; None where it has none for them."""
    found: list[EarthPose | EarthPlace | None] = []
    if (origin := place.get("georeference")) is not None:
        found += [earth_pose(Georeference(**origin), Pose(np.eye(3), at)) for at in positions]
    elif (system := place.get("coordinate_system")) is not None:
        grid = coordinate_system(system)
        found += [grid.place((x, y, z), undulation_m) for x, y, z in positions.tolist()]
    placed = [each for each in found if each is not None]
    if not placed or len(placed) < len(found):
        return None, "ellipsoid"
    ecef = [ecef_of(each.latitude_deg, each.longitude_deg, each.height_m) for each in placed]
    return np.array(ecef), placed[0].height_reference


def _fit_on_earth(positions: Array, ecef: Array, names: Sequence[str]) -> tuple[LevelFit, Georeference | None]:
    """Return the fit in the plane of the map's origin, and that origin on Earth; None where it is too far away to have one plane."""
    reference = ecef.mean(axis=0) if len(ecef) else np.array(ecef_of(0, 0, 0))
    is_far = bool(len(positions)) and float(np.linalg.norm(positions.mean(axis=0))) > _FARTHEST_M
    for _ in range(1 if is_far else _ROUNDS):
        axes = _axes_at(reference)
        fit = fit_level(positions, (ecef - reference) @ axes, names)
        reference, former = reference + axes @ fit.shift, reference
    if is_far:
        return fit, None
    latitude, longitude, height = geodetic_of(tuple(reference.tolist()))
    # The y axis of the map, seen at its origin.
    north = _axes_at(former) @ np.array([-np.sin(fit.yaw_rad), np.cos(fit.yaw_rad), 0.0]) @ _axes_at(reference)
    heading = float(np.degrees(np.arctan2(north[0], north[1])) % 360)
    return fit, Georeference(latitude, longitude, height, heading)


def _axes_at(ecef: Array) -> Array:
    latitude, longitude, _ = geodetic_of(tuple(ecef.tolist()))
    return ecef_from_enu(latitude, longitude)


def _doubts(
    fit: LevelFit, used: Sequence[ControlPoint], warnings: Sequence[str] = ()
) -> tuple[str | None, tuple[str, ...]]:
    """Return the name of a wrong point, and in words what is wrong with points that have a fit nevertheless, after other warnings."""
    number, further = _wrong_point(fit), (*_scale_words(fit), *_tilt_words(fit))
    if number is None:
        return None, (*warnings, *further)
    blunder = (
        f"{used[number].name} is {fit.left_out_m[number]:.2f} m from where the other points put it, which fit to "
        f"{fit.rest_rms_m[number]:.3f} m without it: check its coordinates and its place in the scan, or remove it"
    )
    return used[number].name, (*warnings, blunder, *further)


def _wrong_point(fit: LevelFit) -> int | None:
    """Return the number of the point without which the others fit better than chance explains.

    The squares that it adds to those of the others follow F(3, free) by chance: Baarda's test, with the deviation that the others show
    in place of a stated one. It is made for the worst of all points (Bonferroni).
    """
    count = len(fit.residuals)
    squares, others = float(np.square(fit.residuals).sum()), np.square(fit.rest_rms_m) * (count - 1)
    number, free = int(others.argmin()), 3 * (count - 1) - _UNKNOWNS
    if count <= 3 or fit.left_out_m[number] < _BLUNDER_M:
        return None
    return None if _chance(others[number] / squares, free) * count > _FALSE_ALARMS else number


def _chance(share: float, free: int) -> float:
    """Return how probable it is, at most, that one point of three coordinates leaves the others no more than a share of all squares.

    The incomplete beta function I(free / 2, 3 / 2), of which one factor is taken as 1: that matters where nothing is named anyway.
    """
    half = free / 2
    return float(share**half / half * math.exp(math.lgamma(half + 1.5) - math.lgamma(half) - math.lgamma(1.5)))


def _scale_words(fit: LevelFit) -> tuple[str, ...]:
    if fit.scale_m < _MOST_SCALE_M:
        return ()
    return (
        f"distances between the coordinates are {abs(fit.scale - 1) * 1e6:,.0f} ppm {'longer' if fit.scale > 1 else 'shorter'} than in "
        "the scan, more than clicks explain: a point is wrong, or the scale of the scan or of the coordinates",
    )


def _tilt_words(fit: LevelFit) -> tuple[str, ...]:
    if fit.tilt_deg < _MOST_TILT_DEG or len(fit.residuals) <= 3:
        return ()
    return (
        f"the points fit better with the scan tilted by {fit.tilt_deg:.1f} degrees: it is not level, or a height is wrong",
    )


def georeference_document(found: Georeference) -> dict[str, float]:
    """Return a georeference as maps have it, to the tenth of a millimetre."""
    return {
        name: round(value, 9 if name in ("latitude_deg", "longitude_deg") else 5)
        for name, value in asdict(found).items()
    }
