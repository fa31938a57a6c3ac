"""Maps in responses."""

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.geometry import Box, Vector
from panoloc.service.http.schemas.problem import ProblemDocument

MapStatus = Literal["queued", "reading", "indexing", "ready", "failed"]


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


class Diagnostic(ResponseModel):
    """A remark about a scan."""

    code: str
    severity: Literal["info", "warning", "error"]
    message: str


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


MAP_EXAMPLE = {
    "id": "map_2xk7q0v9m3d1c8fa",
    "name": "3rd floor",
    "tags": ["building 7"],
    "revision": 1,
    "serving_revision": 1,
    "status": "ready",
    "stage": None,
    "progress": 1.0,
    "error": None,
    "created_at": "2026-11-21T12:00:00.000000Z",
    "updated_at": "2026-11-21T12:00:02.400000Z",
    "stats": {
        "num_points": 1_000_000,
        "num_points_used": 250_000,
        "bounds": {"min": [0.0, 0.0, 0.0], "max": [12.4, 8.1, 2.6]},
        "origin_offset": [0.0, 0.0, 0.0],
        "num_starts": 412,
        "index_bytes": 1_830_000,
        "seconds": {"read": 0.5, "starts": 0.2, "render": 1.1},
        "coordinate_system": None,
    },
    "diagnostics": [
        {"code": "thinned", "severity": "info", "message": "1,000,000 points were thinned to 250,000."},
    ],
    "georeference": None,
    "coordinate_system": None,
    "geoid_undulation_m": None,
    "owner": None,
    "shared_with": [],
    "version": 3,
}
QUEUED_MAP_EXAMPLE = {
    **MAP_EXAMPLE,
    "serving_revision": None,
    "status": "queued",
    "progress": 0.0,
    "stats": None,
    "diagnostics": [],
}
