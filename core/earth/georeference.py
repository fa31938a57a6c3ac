"""Places on Earth, by pyproj: of maps in a projected coordinate system (EPSG code or WKT), and earth-centred ones. Needs no numpy."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from panoloc.core.errors import OptionsError

Position = tuple[float, float, float]
HeightReference = Literal["ellipsoid", "geoid", "unknown"]

LONGEST_DEFINITION = 1 << 16
_EPSG = re.compile(r"(?i)epsg:(\d{1,7})(\+\d{1,7})?")
# Not everything that pyproj takes: some forms name files.
_WKT = re.compile(
    r"(?i)\s*(projcs|projcrs|projectedcrs|compd_cs|compoundcrs|boundcrs|geogcs|geogcrs|geodcrs|geoccs)\s*\["
)
_WGS_84 = "EPSG:4326"
_STEP = 10.0  # units of the grid, to its north
# Surveys use a grid beyond its area: Germany lies in a zone that ends 3 degrees before its border.
_BEYOND_DEG = 3.5
_LOCAL_M = 10_000.0  # coordinates of a site of its own are nearer to zero, and those of grids only where their area is
_EXPECTED = (
    "expected a projected coordinate system by EPSG code such as EPSG:25832 (with heights EPSG:25832+7837) or by WKT"
)


@dataclass(frozen=True)
class EarthPlace:
    """A place on WGS 84. height_m: above what height_reference says.

    convergence_deg: from true north clockwise to the north of the grid, so that true heading = grid heading +
    convergence.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float
    height_reference: HeightReference
    convergence_deg: float


class CoordinateSystem:
    """A projected coordinate system.

    definition: "EPSG:25832" where it has a code, else WKT. name: for people. heights: what they are above.
    metres_per_unit: of its coordinates. height_metres_per_unit: of its heights; None where it has none.
    epsg: code of its horizontal part, None without one.
    """

    def __init__(self, text: str):
        """text: EPSG code or WKT. Raises OptionsError for what is none, or is not projected."""
        from pyproj import CRS, Geod, Transformer
        from pyproj.exceptions import CRSError

        if len(text) > LONGEST_DEFINITION or not (_EPSG.fullmatch(text.strip()) or _WKT.match(text)):
            raise OptionsError(f"coordinate_system: {_EXPECTED}, got {text[:60]!r}")
        try:
            system: Any = CRS.from_user_input(text.strip())
        except CRSError as error:
            raise OptionsError(f"coordinate_system: {_EXPECTED}, got {text[:60]!r} ({str(error)[:120]})") from error
        if not system.is_projected:
            raise OptionsError(
                f"coordinate_system: {_EXPECTED}, got {system.name[:80]!r}, whose coordinates are no lengths on a grid"
            )
        horizontal = system.sub_crs_list[0] if system.is_compound else system
        code = system.to_authority("EPSG")
        self.definition = f"EPSG:{code[1]}" if code else text.strip()
        self.name: str = system.name
        self.heights: HeightReference = "geoid" if system.is_compound else _heights_of(system)
        self.metres_per_unit = float(system.axis_info[0].unit_conversion_factor)
        self.height_metres_per_unit = (
            float(system.axis_info[2].unit_conversion_factor) if len(system.axis_info) > 2 else None
        )
        self._to_earth = Transformer.from_crs(horizontal.to_2d(), _WGS_84, always_xy=True)
        self._ellipsoid = Geod(ellps="WGS84")
        self._area = system.area_of_use
        found = horizontal.to_authority("EPSG")
        self.epsg = int(found[1]) if found else None
        self._system = system

    @property
    def wkt_in_metres(self) -> str:
        """Return WKT (OGC 01-009, where that can say it) of the same system with positions in metres, heights included."""
        from pyproj import CRS
        from pyproj.exceptions import CRSError

        document = self._system.to_json_dict()
        system = CRS.from_json_dict(document) if _to_metres(document) else self._system
        try:
            return str(system.to_wkt("WKT1_GDAL"))
        except CRSError:
            return str(system.to_wkt())

    def place(self, position_m: Position, geoid_undulation_m: float | None = None) -> EarthPlace | None:
        """Return where a position lies; None outside of where the system is defined, and far outside of where it is used.

        position_m: east, north and height of the grid, in metres whatever its unit. geoid_undulation_m: of the geoid
        above the ellipsoid, which makes heights above one heights above the other.
        """
        east, north = (value / self.metres_per_unit for value in position_m[:2])
        longitude, latitude = self._to_earth.transform(east, north)
        ahead = self._to_earth.transform(east, north + _STEP)
        if not all(math.isfinite(value) for value in (longitude, latitude, *ahead)):
            return None
        if not self._is_used_at(longitude, latitude, math.hypot(*position_m[:2]) < _LOCAL_M):
            return None
        azimuth, _, _ = self._ellipsoid.inv(longitude, latitude, *ahead)
        height, reference = position_m[2], self.heights
        if reference != "ellipsoid" and geoid_undulation_m is not None:
            height, reference = height + geoid_undulation_m, "ellipsoid"
        return EarthPlace(latitude, longitude, height, reference, azimuth)

    def why_outside(self, position_m: Position) -> str:
        """Say of a scan at a position, metres, that it is outside of the system."""
        east, north, _ = position_m
        return (
            f"the scan, at {east:,.0f} m east and {north:,.0f} m north, lies outside its area{self.how_inside(position_m)}; name the "
            "system of its coordinates, or leave it out and give the map a georeference"
        )

    def how_inside(self, position_m: Position) -> str:
        """Say what is usually wrong with a position, metres, that is outside of the system, if that brings it inside."""
        (east, north, height), zone = position_m, 1_000_000 * self.metres_per_unit
        likely = {
            "with x and y exchanged": (north, east, height),
            "without the zone before x": (east % zone, north, height),
        }
        return "".join(
            f"; {words} it would be inside" for words, place in likely.items() if self.place(place) is not None
        )

    def _is_used_at(self, longitude: float, latitude: float, may_be_local: bool) -> bool:
        """Return whether a place is in the area of the system, or not far outside; of some systems nothing is known."""
        if self._area is None:
            return True
        beyond, (west, south, east, north) = 0.0 if may_be_local else _BEYOND_DEG, self._area.bounds
        half = ((east - west) % 360 or 360) / 2  # of some systems beyond the 180th meridian, of others all around
        off = abs((longitude - west - half + 180) % 360 - 180)
        is_near: bool = south - beyond <= latitude <= north + beyond and off <= half + beyond
        return is_near

    def grid_position(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float] | None:
        """Return east and north of a place on WGS 84, in the unit of the grid; None outside of where the system is defined."""
        east, north = self._to_earth.transform(longitude_deg, latitude_deg, direction="INVERSE")
        return (east, north) if math.isfinite(east) and math.isfinite(north) else None


@lru_cache(maxsize=64)
def coordinate_system(text: str) -> CoordinateSystem:
    """Return the coordinate system by EPSG code or WKT; making one takes a tenth of a second. Raises OptionsError."""
    return CoordinateSystem(text)


def _to_metres(document: Any) -> bool:
    """Let the axes of a system in PROJJSON count metres; return whether any did not. Its constants have units of their own."""
    parts = list(_parts_of(document))
    axes = [axis for part in parts for axis in part.get("coordinate_system", {}).get("axis", ())]
    others = [axis for axis in axes if axis["unit"] not in ("metre", "degree")]
    for axis in others:
        axis["unit"] = "metre"
    for part in parts if others else ():
        part.pop("id", None)  # it is no longer the system of its code and name
        part["name"] = f"{part.get('name', 'grid')}, in metres"
    return bool(others)


def _parts_of(document: Any) -> Iterator[Any]:
    yield document
    for part in (*document.get("components", ()), *(document[name] for name in ("source_crs",) if name in document)):
        yield from _parts_of(part)


def _heights_of(system: Any) -> HeightReference:
    """A system of three axes that is not compound has heights above its own ellipsoid."""
    return "ellipsoid" if len(system.axis_info) > 2 else "unknown"


@lru_cache
def _ecef_from_geodetic() -> Any:
    from pyproj import Transformer

    return Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def ecef_of(latitude_deg: float, longitude_deg: float, height_m: float) -> Position:
    """Return the earth-centred position in metres of a place on WGS 84. height_m: above the ellipsoid."""
    x, y, z = _ecef_from_geodetic().transform(longitude_deg, latitude_deg, height_m)
    return x, y, z


def geodetic_of(ecef: Position) -> Position:
    """Return latitude and longitude in degrees and the height above the ellipsoid in metres of an earth-centred position."""
    longitude, latitude, height = _ecef_from_geodetic().transform(*ecef, direction="INVERSE")
    return latitude, longitude, height
