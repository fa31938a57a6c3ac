"""Maps: the options of one, what can be changed of it, and links to it."""

import re
from dataclasses import replace
from typing import Annotated, Any

from pydantic import AfterValidator, Field, HttpUrl, StringConstraints, field_validator

from panoloc.core import options
from panoloc.core.earth.georeference import LONGEST_DEFINITION, coordinate_system
from panoloc.core.errors import OptionsError
from panoloc.core.options import (
    MAX_SPACING_M,
    MIN_SPACING_M,
    ColorKind,
    IndexOptions,
    StartsMethod,
    UnitChoice,
    UpAxisChoice,
)
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.queries import Region, RequestModel
from panoloc.service.jobs import LONGEST_NAME, LONGEST_TAG, RegisterOptions

# No control characters: names and tags end up in logs, terminals and URLs. Those of Latin-1 also begin escape
# sequences, and those of Unicode reverse lines.
_CONTROL = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069"
PRINTABLE = rf"^[^{_CONTROL}]*$"

Name = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_NAME, pattern=PRINTABLE)
]
Tag = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=LONGEST_TAG, pattern=PRINTABLE)]
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
    region: Region | None = Field(None, description="Possible camera positions; null: the whole scanned space.")


class ReadingOptions(RequestModel):
    """How to read the coordinates of a scan; `auto`: as the file says, else by what a building looks like."""

    unit: UnitChoice = Field(options.ScanOptions.unit, description="Unit of the scan's coordinates.")
    height_unit: UnitChoice = Field(
        options.ScanOptions.height_unit, description="Unit of the heights, where it is another one."
    )
    up_axis: UpAxisChoice = Field(options.ScanOptions.up_axis, description="Axis of the scan that points up.")


class ScanOptions(ReadingOptions):
    """How to read a scan and what to build from it."""

    color_kind: ColorKind = Field(
        options.ScanOptions.color_kind, description="`labels`: colours encode semantic classes."
    )
    starts: StartsOptions = Field(default_factory=lambda: StartsOptions.model_validate({}))

    def to_options(self) -> RegisterOptions:
        """Return the options for the worker."""
        region = None if self.starts.region is None else self.starts.region.to_options()
        return RegisterOptions(
            options.ScanOptions(self.unit, self.up_axis, self.height_unit, color_kind=self.color_kind),
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


class PlaceOnEarth(RequestModel):
    """Where a map is on Earth."""

    georeference: Georeference | None = None
    coordinate_system: CoordinateSystem | None = Field(
        None,
        description="Projected coordinate system of the map's positions, by EPSG code such as `EPSG:25832` or by WKT; "
        "null: from the scan's file.",
    )
    # On Earth it lies between -107 and 86 m.
    geoid_undulation_m: Annotated[float, Field(ge=-200, le=200)] | None = Field(
        None,
        description="Height of the geoid above the ellipsoid at the map, metres. Needed for a GeoPose if the heights "
        "of the `coordinate_system` are above the geoid, or if their reference is unknown.",
    )


class MapOptions(ScanOptions, PlaceOnEarth):
    """The part `options` of `POST /maps`."""

    def to_options(self) -> RegisterOptions:
        """Return the options for the worker: the units of a coordinate system are those of the scan."""
        found = super().to_options()
        return replace(found, scan=replace(found.scan, coordinate_system=self.coordinate_system))

    name: Name | None = Field(None, description="Display name; default: the file's name.")
    tags: Tags = Field(default_factory=list, description="A query can name a tag instead of maps.")


_READING = frozenset(ReadingOptions.model_fields)


class MapPatch(ReadingOptions, PlaceOnEarth):
    """The body of `PATCH /maps/{id}`: fields left out stay unchanged; null removes a place on Earth.

    With another unit or up axis the stored scan is registered again.
    """

    # Not sent unless given, so what is default here means nothing.
    name: Name = Field(default_factory=str)
    tags: Tags = Field(default_factory=list)
    shared_with: Tags = Field(
        default_factory=list, description="Other tenants that can view the map and localize in it; `*` for all."
    )

    def changes(self) -> dict[str, Any]:
        """Return the given fields of the map itself as JSON."""
        return self.model_dump(mode="json", include=set(self.model_fields_set - _READING))

    def reading(self) -> dict[str, Any]:
        """Return the given fields about how the scan is read."""
        return self.model_dump(include=set(self.model_fields_set & _READING))


class LinkRequest(RequestModel):
    """The body of `POST /maps/{id}/links`."""

    service_url: HttpUrl = Field(
        description="Address under which phones reach the service, without query or credentials."
    )

    @field_validator("service_url")
    @classmethod
    def _is_an_address_alone(cls, value: HttpUrl) -> HttpUrl:
        if value.query or value.fragment or value.username or value.password:
            raise ValueError(
                "expected an address alone, such as https://scanner.local:8000, got one with a query, a fragment or credentials"
            )
        return value


class MapLink(ResponseModel):
    """A link that opens a map on a phone."""

    url: str = Field(description="Page of the map. What follows `#` never leaves the phone.")
    key_id: str | None = Field(
        description="Id of the key in the link, which can localize in this map and read it; null: the service requires none."
    )
    qr_svg: str = Field(description="QR code of the link, SVG.")
