"""The body of every error, and the state of the service."""

from datetime import datetime
from typing import Literal

from pydantic import Field

from panoloc.service.answer import ResponseModel


class FieldMistake(ResponseModel):
    """One wrong field of the options, or one wrong part of the form."""

    field: str = Field(examples=["hints.radius_m"])
    message: str = Field(examples=["Input should be greater than 0, got -1"])


class ProblemDocument(ResponseModel):
    """A problem document (RFC 9457)."""

    type: str = Field(description="Stable URI of the kind of problem, relative to the service.")
    title: str = Field(description="The kind of problem, for people.")
    status: int = Field(ge=400, le=599)
    detail: str = Field(description="What was expected, what came and what to do.")
    request_id: str = Field(description="The service's log has details under this id.")
    fields: list[FieldMistake] | None = Field(
        None, description="Wrong fields of the options, or the faulty upload, `image` or `mask`."
    )


class Liveness(ResponseModel):
    """The process runs."""

    status: Literal["live"] = "live"


class PoolHealth(ResponseModel):
    """The workers."""

    ready: bool
    waiting_for: str | None
    num_workers: int
    queue_depth: int = Field(description="Queries waiting for a worker.")
    resident_bytes: int = Field(description="Map indexes in the workers' memory.")


class RecentError(ResponseModel):
    """A request or a registration that ended in a problem."""

    at: datetime
    method: str
    path: str
    type: str | None
    title: str | None
    status: int | None
    detail: str | None
    request_id: str | None = Field(description="As in the log.")


class Readiness(ResponseModel):
    """Readiness, for probes without a key."""

    status: Literal["ready", "not_ready"]


class Health(ResponseModel):
    """The whole service."""

    status: Literal["ready", "not_ready"]
    waiting_for: list[str] = Field(description="Missing parts; empty when ready.", examples=[["workers"]])
    version: str
    uptime_s: float
    redis: Literal["up", "down"]
    storage: Literal["writable", "not_writable"]
    workers: PoolHealth
    recent_errors: list[RecentError] = Field(
        default_factory=list,
        description="Only in `/health`: the last 50, newest first: requests since the process started, and maps that failed.",
    )
    maps: dict[str, int] = Field(description="Maps by status.", examples=[{"ready": 3, "queued": 1}])
