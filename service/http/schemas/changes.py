"""What changed in a map since its scan."""

from datetime import datetime
from typing import Literal

from pydantic import Field

from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.queries import Vector


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
