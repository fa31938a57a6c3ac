"""Options of a map."""

import re
from dataclasses import replace
from typing import Annotated, Any

from pydantic import AfterValidator, Field, StringConstraints

from panoloc.core import options
from panoloc.core.errors import OptionsError
from panoloc.core.georeference import LONGEST_DEFINITION, coordinate_system
from panoloc.core.options import MAX_SPACING_M, MIN_SPACING_M, ColorKind, IndexOptions, StartsMethod, Unit, UpAxis
from panoloc.service.http.schemas.geometry import Box, RequestModel
from panoloc.service.jobs import LONGEST_NAME, LONGEST_TAG, RegisterOptions

# No control characters: names and tags end up in logs, terminals and URLs. Those of Latin-1 also begin escape
# sequences, and those of Unicode reverse lines.
_CONTROL = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069"
_PRINTABLE = rf"^[^{_CONTROL}]*$"

_COORDINATE_SYSTEM = (
    "Projected coordinate system of the map's positions, by EPSG code such as `EPSG:25832` or by WKT; "
    "null: from the scan's file."
)
_GEOID_UNDULATION = (
    "Height of the geoid above the ellipsoid at the map, metres. Needed for a GeoPose if the heights of the "
    "`coordinate_system` are above the geoid, or if their reference is unknown."
)
Name = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_NAME, pattern=_PRINTABLE)
]
Tag = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_TAG, pattern=_PRINTABLE)]
Tags = Annotated[list[Tag], Field(max_length=32), AfterValidator(lambda tags: list(dict.fromkeys(tags)))]


def name_of_file(file_name: str) -> str:
    """Return a file's name as a valid `Name`: without control characters, and cut. May be empty."""
    return re.sub(rf"[{_CONTROL}]", "", file_name).strip()[:LONGEST_NAME].strip()


class StartsOptions(RequestModel):
    """Start positions of the search."""

    method: StartsMethod = Field(IndexOptions.starts_method, description="`octree` for rooms, `grid` for open spaces.")
    spacing_m: float | None = Field(
        None, ge=MIN_SPACING_M, le=MAX_SPACING_M, description="Distance between starts; null: the service chooses."
    )
    region: Box | None = Field(None, description="Possible camera positions; null: the whole scanned space.")


class ScanOptions(RequestModel):
    """How to read a scan and what to build from it."""

    unit: Unit = Field(options.ScanOptions.unit, description="Unit of the scan's coordinates.")
    up_axis: UpAxis = Field(options.ScanOptions.up_axis, description="Axis of the scan that points up.")
    color_kind: ColorKind = Field(
        options.ScanOptions.color_kind, description="`labels`: colours encode semantic classes."
    )
    starts: StartsOptions = Field(default_factory=lambda: StartsOptions.model_validate({}))

    def to_options(self) -> RegisterOptions:
        """Return the options for the worker."""
        region = None if self.starts.region is None else self.starts.region.to_options()
        return RegisterOptions(
            options.ScanOptions(self.unit, self.up_axis, self.color_kind),
            IndexOptions(self.starts.method, self.starts.spacing_m, region, self.color_kind),
        )

    def over(self, former: RegisterOptions) -> RegisterOptions:
        """Return what the worker has to know when fields that are left out are as they were."""
        given, names = self.to_options(), self.model_fields_set
        scan = replace(former.scan, **{name: getattr(given.scan, name) for name in names - {"starts"}})
        index = given.index if "starts" in names else former.index
        return RegisterOptions(scan, replace(index, color_kind=scan.color_kind))


class Georeference(RequestModel):
    """Position of the map's origin on Earth (WGS 84)."""

    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    height_m: float = Field(0.0, ge=-20_000, le=100_000, description="Above the ellipsoid.")
    heading_deg: float = Field(
        0.0, ge=-360, le=360, description="Compass heading of the map's y axis, clockwise from north."
    )


def _recognised(text: str) -> str:
    try:
        return coordinate_system(text).definition
    except OptionsError as error:
        raise ValueError(str(error)) from error


CoordinateSystem = Annotated[
    str, StringConstraints(min_length=1, max_length=LONGEST_DEFINITION), AfterValidator(_recognised)
]
# On Earth it lies between -107 and 86 m.
GeoidUndulation = Annotated[float, Field(ge=-200, le=200)]


class MapOptions(ScanOptions):
    """The part `options` of `POST /maps`."""

    name: Name | None = Field(None, description="Display name; default: the file's name.")
    tags: Tags = Field(default_factory=list, description="A query can name a tag instead of maps.")
    georeference: Georeference | None = None
    coordinate_system: CoordinateSystem | None = Field(None, description=_COORDINATE_SYSTEM)
    geoid_undulation_m: GeoidUndulation | None = Field(None, description=_GEOID_UNDULATION)


class MapPatch(RequestModel):
    """The body of `PATCH /maps/{id}`: fields left out stay unchanged; null removes a place on Earth."""

    name: Name = ""
    tags: Tags = Field(default_factory=list)
    georeference: Georeference | None = None
    coordinate_system: CoordinateSystem | None = Field(None, description=_COORDINATE_SYSTEM)
    geoid_undulation_m: GeoidUndulation | None = Field(None, description=_GEOID_UNDULATION)
    shared_with: Tags = Field(
        default_factory=list, description="Other tenants that can view the map and localize in it; `*` for all."
    )

    def changes(self) -> dict[str, Any]:
        """Return the given fields as JSON."""
        return self.model_dump(mode="json", include=self.model_fields_set)


MAP_OPTIONS_EXAMPLE = {
    "name": "3rd floor",
    "tags": ["building 7"],
    "unit": "mm",
    "starts": {"method": "octree", "region": {"min": [0, 0, 0.5], "max": [12, 8, 2.2]}},
}
