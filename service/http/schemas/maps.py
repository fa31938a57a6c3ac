"""Maps: the options of one, what responses say of it, and what changed since its scan."""

import re
from dataclasses import replace
from datetime import datetime
from typing import Annotated, Any, Literal

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
    Unit,
    UnitChoice,
    UpAxis,
    UpAxisChoice,
)
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.http.schemas.queries import Box, RequestModel, Vector
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
    region: Box | None = Field(None, description="Possible camera positions; null: the whole scanned space.")


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


MapStatus = Literal["queued", "reading", "indexing", "ready", "failed"]


class Floor(ResponseModel):
    """A floor of the scanned building."""

    level_m: float = Field(description="Level of the floor in the map's own frame, metres.")
    height_m: float | None = Field(description="Clear height up to the ceiling, metres; null where none was scanned.")


Source = Literal["given", "file", "judged", "assumed"]


class ReadAs(ResponseModel):
    """How the coordinates of a scan were read, and who says so: the caller, the file, or what was scanned."""

    unit: Unit | None = Field(description="Null: a unit that has no name here.")
    height_unit: Unit | None
    up_axis: UpAxis
    unit_from: Source
    height_unit_from: Source
    up_axis_from: Source


class MapStats(ResponseModel):
    """Figures of a finished registration."""

    num_points: int = Field(description="Points in the scan.")
    num_points_used: int = Field(description="Points that remain after thinning.")
    bounds: Box
    origin_offset: Vector
    num_starts: int
    index_bytes: int
    seconds: dict[str, float] = Field(description="Duration of each stage.")
    coordinate_system: str | None = Field(None, description="Of the scan's coordinates, if its file names one.")
    read_as: ReadAs | None = Field(None, description="Unit and axes of the scan; null for maps of earlier versions.")
    floors: list[Floor] = Field(default_factory=list, description="Floors that were found in the scan, bottom up.")


class ReadingChoice(ResponseModel):
    """An answer to a question about a scan."""

    label: str
    patch: dict[str, str] = Field(description="The body for `PATCH /maps/{id}` that gives this answer.")
    storey_height_m: float | None = Field(description="Between floor and ceiling, read in this way.")
    extent_m: list[float] = Field(description="Of the scan along x, y and z, read in this way.")


class ReadingQuestion(ResponseModel):
    """What the file and the scanned building leave open."""

    text: str
    choices: list[ReadingChoice]


class Diagnostic(ResponseModel):
    """A remark about a scan."""

    code: str
    severity: Literal["info", "warning", "error"]
    message: str
    question: ReadingQuestion | None = Field(
        None,
        description="How to end a doubt about unit, heights or up axis. Until then, answers of the map warn of it.",
    )


class Map(ResponseModel):
    """A registered scan.

    After `PUT /maps/{id}/scan`, `revision`, `status`, `stage`, `progress` and `error` describe the new revision. Until
    it is ready, `serving_revision` answers queries; `stats` and `diagnostics` belong to that revision.
    """

    id: str
    name: str
    tags: list[str]
    revision: int = Field(ge=1, description="The newest revision of the scan.")
    serving_revision: int | None = Field(description="The serving revision; null until the first is ready.")
    status: MapStatus
    stage: str | None = Field(description="Current step of the registration, for people.")
    progress: float = Field(ge=0, le=1)
    error: ProblemDocument | None
    created_at: datetime
    updated_at: datetime
    stats: MapStats | None
    diagnostics: list[Diagnostic]
    georeference: dict[str, Any] | None
    coordinate_system: str | None = Field(
        description="Coordinate system of positions, as an EPSG code or WKT: as given, else from the scan's file; "
        "null: none."
    )
    geoid_undulation_m: float | None = Field(
        None, description="Height of the geoid above the ellipsoid at the map, metres, as given."
    )
    owner: str | None = Field(None, description="Tenant of the key that created the map; null: none.")
    shared_with: list[str] = Field(
        default_factory=list, description="Other tenants that can view the map; `*` for all."
    )
    version: int = Field(
        0,
        ge=0,
        description="Increases with each change; a change with `If-Match` requires this version.",
    )


class MapPage(ResponseModel):
    """A page of maps, oldest first."""

    items: list[Map]
    next_cursor: str | None = Field(description="Send it as `cursor` for the next page; null on the last one.")


class Start(ResponseModel):
    """A start position of the search."""

    position_m: Vector
    leaf_size_m: float = Field(description="Edge length of the octree leaf, or of the grid cell, around it.")


class MapStarts(ResponseModel):
    """All starts of a map, in its own frame."""

    map_id: str
    revision: int
    num_starts: int
    starts: list[Start]


class AnswerWithChange(ResponseModel):
    """One of the answers in use."""

    id: str | None = Field(
        description="Id of the localization, whose answer may have expired; null for keys of a tenant, because "
        "tenants may share the map."
    )
    created_at: datetime
    position_m: Vector = Field(description="Position of the photo.")
    confidence: float
    panorama_changed_fraction: float | None
    map_changed_fraction: float | None


class ChangedCell(ResponseModel):
    """A cube with a change."""

    center_m: Vector
    num_changed: int = Field(ge=1, description="Answers that saw a change here.")
    num_seen: int = Field(ge=1, description="Answers that saw this cell at all.")
    last_changed_at: datetime


class ObjectChange(ResponseModel):
    """An object that came, went or moved. Positions are in the map's own frame, in metres."""

    id: str = Field(description="12 hex digits, made of kind and place.")
    kind: Literal["came", "went", "moved"]
    center_m: Vector = Field(description="Middle of its box; of what went, where it was.")
    size_m: Vector = Field(description="Edges of its box along the map's axes.")
    from_m: Vector | None = Field(description="Where it was before; null unless it moved.")
    floor: int | None = Field(
        description="Floor that it stands on, 0 for the lowest of `stats.floors`; null if none is known."
    )
    certainty: float = Field(
        ge=0,
        le=1,
        description="How probable it is that this object changed. More photos and stronger contrast make it surer.",
    )
    is_sure: bool = Field(
        description="False where the certainty is too low to state the change: look at the picture, or leave it out."
    )
    num_photos: int = Field(
        ge=1, description="Photos that saw the change. With one, its place is a guess along the line of sight."
    )
    seen_from_m: Vector = Field(description="Position of the photo that shows it best.")
    first_seen_at: datetime
    last_seen_at: datetime


class MapChanges(ResponseModel):
    """Changes since the scan, from the answers of the last `lifetime_s` seconds, or of the period that was asked for."""

    map_id: str
    revision: int = Field(description="Serving revision of the scan; answers from other revisions do not count.")
    lifetime_s: int = Field(description="Seconds for which an answer counts.")
    cell_m: float | None = Field(description="Edge length of a cell in metres; null without answers.")
    answers: list[AnswerWithChange] = Field(description="Newest first.")
    num_photos: int = Field(
        description="Small photos that are kept, in which objects are looked for: of batches, and of other queries where the operator "
        "keeps images."
    )
    objects: list[ObjectChange] = Field(description="The surest first. Empty without kept photos.")
    cells: list[ChangedCell] = Field(description="Cells, those with the most changes first.")
