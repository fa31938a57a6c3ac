"""Changes since a map's scan."""

from datetime import datetime
from typing import Any

from pydantic import Field

from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.geometry import Vector


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


class MapChanges(ResponseModel):
    """Changes since the scan, from the answers of the last `lifetime_s` seconds."""

    map_id: str
    revision: int = Field(description="Serving revision of the scan; answers from other revisions do not count.")
    lifetime_s: int = Field(description="Seconds for which an answer counts.")
    cell_m: float | None = Field(description="Edge length of a cell in metres; null without answers.")
    answers: list[AnswerWithChange] = Field(description="Newest first.")
    cells: list[ChangedCell] = Field(description="Cells, those with the most changes first.")


CHANGES_EXAMPLE: dict[str, Any] = {
    "map_id": "map_2xk7q0v9m3d1c8fa",
    "revision": 1,
    "lifetime_s": 2_592_000,
    "cell_m": 0.15,
    "answers": [
        {
            "id": "loc_9b1f0c6a7d2e4f35",
            "created_at": "2026-11-21T12:00:00Z",
            "position_m": [1.2, 0.3, 1.5],
            "confidence": 0.93,
            "panorama_changed_fraction": 0.18,
            "map_changed_fraction": 0.11,
        }
    ],
    "cells": [
        {"center_m": [2.025, 0.975, 0.375], "num_changed": 1, "num_seen": 1, "last_changed_at": "2026-11-21T12:00:00Z"}
    ],
}
