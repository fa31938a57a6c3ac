"""Control points of a map."""

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from panoloc.core.errors import OptionsError
from panoloc.core.survey.control_csv import MOST_POINTS, ControlPoint, read_control_points
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.maps import PRINTABLE, CoordinateSystem, Georeference
from panoloc.service.http.schemas.queries import Coordinate, RequestModel, Vector
from panoloc.service.maps.control import ControlPoints

_LONGEST_CSV = 60_000


class SentPoint(RequestModel):
    """A point whose coordinates are known: x, y, z, or latitude, longitude and height."""

    name: Annotated[str, Field(min_length=1, max_length=80, pattern=PRINTABLE)]
    x: Coordinate | None = Field(
        None, description="East, metres, in the `coordinate_system`; without one, of a site or of the map itself."
    )
    y: Coordinate | None = Field(None, description="North.")
    z: Coordinate | None = Field(None, description="Height.")
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = Field(None, description="WGS 84.")
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] | None = None
    height_m: Annotated[float, Field(ge=-20_000, le=100_000)] | None = Field(None, description="Above the ellipsoid.")
    position_m: Vector | None = Field(
        None,
        description="The point in the map's own frame, as clicked in the scan; null: as stored for this name, or not known yet.",
    )

    @model_validator(mode="after")
    def _is_known_in_one_way(self) -> Self:
        grid = [each is not None for each in (self.x, self.y, self.z)]
        earth = [each is not None for each in (self.latitude_deg, self.longitude_deg, self.height_m)]
        if not (all(grid) and not any(earth)) and not (all(earth) and not any(grid)):
            raise ValueError(
                "expected x, y and z, or latitude_deg, longitude_deg and height_m; send all three of one kind"
            )
        return self

    def to_point(self) -> ControlPoint:
        """Return the point for the check."""
        at = None if self.position_m is None else (self.position_m[0], self.position_m[1], self.position_m[2])
        if self.x is not None and self.y is not None and self.z is not None:
            return ControlPoint(self.name, (self.x, self.y, self.z), False, at)
        return ControlPoint(
            self.name, (self.latitude_deg or 0.0, self.longitude_deg or 0.0, self.height_m or 0.0), True, at
        )


class ControlBody(RequestModel):
    """The body of `PUT /maps/{id}/control-points`: all points of the map, in place of the former ones."""

    points: Annotated[list[SentPoint], Field(max_length=MOST_POINTS)] | None = None
    csv: Annotated[str, Field(max_length=_LONGEST_CSV)] | None = Field(
        None,
        description="Instead of `points`: the text of a CSV with the columns name, x, y, z or name, lat, lon, height; and map_x, map_y, "
        "map_z where the places in the scan are known. Other usual headings, delimiters and decimal commas are understood.",
    )
    coordinate_system: CoordinateSystem | None = Field(
        None, description="Of x and y, by EPSG code or WKT; null: that of the map, or none."
    )
    geoid_undulation_m: Annotated[float, Field(ge=-200, le=200)] | None = Field(
        None, description="Height of the geoid above the ellipsoid; null: that of the map."
    )

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if (self.points is None) == (self.csv is None):
            got = "neither" if self.points is None else "both"
            raise ValueError(f"expected either points or csv, got {got}; send one of them")
        names = [each.name for each in self.points or ()]
        if len(set(names)) < len(names):
            raise ValueError("points: expected each name once; rename the others")
        return self

    def to_points(self) -> ControlPoints:
        """Return the points. Raises OptionsError for a CSV that cannot be read, with its lines at fault."""
        points = (
            read_control_points(self.csv) if self.csv is not None else [each.to_point() for each in self.points or ()]
        )
        if self.coordinate_system is not None and all(point.is_geodetic for point in points) and points:
            raise OptionsError(
                "coordinate_system: expected none for latitudes and longitudes, which are WGS 84; leave it out"
            )
        return ControlPoints(points, self.coordinate_system, self.geoid_undulation_m)


class Residual(ResponseModel):
    """Place in the map minus known coordinates, metres: true east, true north and up; without a place on Earth along x, y, z."""

    east_m: float
    north_m: float
    up_m: float
    horizontal_m: float
    distance_m: float


class CheckedPoint(ResponseModel):
    """A control point and its residuals."""

    name: str
    x: float | None
    y: float | None
    z: float | None
    latitude_deg: float | None
    longitude_deg: float | None
    height_m: float | None
    position_m: list[float] | None = Field(description="The point in the map's own frame; null while it is not known.")
    as_is: Residual | None = Field(description="As the map stands; null where it has no place to compare with.")
    fitted: Residual | None = Field(description="After the fit.")
    left_out_m: float | None = Field(description="Distance from where the fit of all other points puts this one.")


class ControlSummary(ResponseModel):
    """Root mean squares over the points."""

    num_points: int
    rms_horizontal_m: float
    rms_up_m: float
    rms_m: float
    largest_m: float


class ControlFit(ControlSummary):
    """The best turn about the vertical and shift of the map."""

    rms_left_out_m: float = Field(
        description="Of each point against the fit of the others: what a point without control can be off by."
    )
    turn_deg: float = Field(description="Counter-clockwise, from the map to the coordinates.")
    scale: float = Field(description="Distances of the coordinates to those of the map; the fit does not scale.")
    tilt_deg: float = Field(description="Of the fit that also tilts; the fit itself is level.")
    georeference: Georeference | None = Field(
        description="For `PATCH /maps/{id}`; null where `no_georeference` says why."
    )


class ControlReport(ResponseModel):
    """What control points say of a map."""

    map_id: str
    revision: int
    is_on_earth: bool = Field(description="False for coordinates without a coordinate system.")
    coordinate_system: str | None = Field(description="As sent with the points.")
    geoid_undulation_m: float | None
    points: list[CheckedPoint]
    as_is: ControlSummary | None
    fit: ControlFit | None
    no_fit: str | None = Field(description="Why there is no fit, and what to do.")
    no_georeference: str | None
    suspect: str | None = Field(
        description="Name of the point that the others show to be wrong; a warning says by how much."
    )
    warnings: list[str]


_RESIDUAL: dict[str, Any] = {
    "east_m": 0.006,
    "north_m": -0.004,
    "up_m": 0.003,
    "horizontal_m": 0.00721,
    "distance_m": 0.00781,
}
_SUMMARY: dict[str, Any] = {
    "num_points": 4,
    "rms_horizontal_m": 0.008,
    "rms_up_m": 0.004,
    "rms_m": 0.00894,
    "largest_m": 0.012,
}
CONTROL_BODY_EXAMPLE: dict[str, Any] = {
    "csv": "name,x,y,z\nP1,691000.120,5334000.310,520.114\nP2,691028.704,5334002.918,520.120\n",
    "coordinate_system": "EPSG:25832",
}
CONTROL_EXAMPLE: dict[str, Any] = {
    "map_id": "map_2xk7q0v9m3d1c8fa",
    "revision": 1,
    "is_on_earth": True,
    "coordinate_system": "EPSG:25832",
    "geoid_undulation_m": 46.2,
    "points": [
        {
            "name": "P1",
            "x": 691000.12,
            "y": 5334000.31,
            "z": 520.114,
            **dict.fromkeys(("latitude_deg", "longitude_deg", "height_m")),
            "position_m": [0.52, 4.1, 0.02],
            "as_is": None,
            "fitted": _RESIDUAL,
            "left_out_m": 0.015,
        }
    ],
    "as_is": None,
    "fit": {
        **_SUMMARY,
        "rms_left_out_m": 0.014,
        "turn_deg": -37.25,
        "scale": 1.0002,
        "tilt_deg": 0.02,
        "georeference": {"latitude_deg": 48.1371, "longitude_deg": 11.5754, "height_m": 562.3, "heading_deg": 37.25},
    },
    "no_fit": None,
    "no_georeference": None,
    "suspect": None,
    "warnings": [],
}
