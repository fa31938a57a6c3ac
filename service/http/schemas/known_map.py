"""What responses say of a map: how its scan was read, what it measures, where a search in it starts, and what changed since."""

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from panoloc.core.options import Unit, UpAxis
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.http.schemas.queries import Box, Vector

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
