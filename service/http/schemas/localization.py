"""Options of a query, and the state of one whose answer is fetched later."""

from datetime import datetime
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from panoloc.core import options
from panoloc.core.options import (
    DEFAULT_HEADING_TOLERANCE_DEG,
    DEFAULT_RADIUS_M,
    DEFAULT_TILT_DEG,
    MAX_IMAGES,
    MAX_TOP_K,
    Frame,
    Method,
    SessionOptions,
)
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.cameras import Camera, TrackedSession
from panoloc.service.http.schemas.geometry import Box, RequestModel, Vector
from panoloc.service.http.schemas.problem import ProblemDocument
from panoloc.service.jobs import ARTIFACTS, Artifact, QueryOptions


class Hints(RequestModel):
    """Prior knowledge of the caller. Every hint narrows the search, and every answer satisfies it."""

    position_m: Vector | None = Field(None, description="Camera position in the map's own frame.")
    radius_m: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None, description=f"Largest distance from `position_m`; {DEFAULT_RADIUS_M:g} by default."
    )
    region: Box | None = Field(None, description="Box around the camera in the map's own frame.")
    upright: bool | None = Field(None, description="The camera is level within `max_tilt_deg`.")
    max_tilt_deg: Annotated[float, Field(ge=0, le=180)] | None = Field(
        None, description=f"{DEFAULT_TILT_DEG:g} when only `upright` is given."
    )
    heading_deg: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None, description="Yaw of the image centre, counter-clockwise about z from +x."
    )
    heading_tolerance_deg: Annotated[float, Field(gt=0, le=180)] | None = Field(
        None, description=f"{DEFAULT_HEADING_TOLERANCE_DEG:g} by default."
    )

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        if self.radius_m is not None and self.position_m is None:
            raise ValueError("radius_m: expected together with position_m; give the position or leave out the radius")
        if self.heading_tolerance_deg is not None and self.heading_deg is None:
            raise ValueError(
                "heading_tolerance_deg: expected together with heading_deg; give the heading or leave out the tolerance"
            )
        return self

    def to_options(self) -> options.Hints | None:
        """Return the hints as the algorithm takes them, None when none is given."""
        given = self.model_dump(exclude_none=True)
        if self.position_m is not None:
            given["position_m"] = tuple(self.position_m)
        if self.region is not None:
            given["region"] = self.region.to_options()
        return options.Hints(**given) if given else None


class LocalizeOptions(RequestModel):
    """The part `options` of `POST /localize`."""

    frame: Frame = Field(QueryOptions.frame, description="Axes of the answer; see docs/api.md.")
    method: Method = Field(QueryOptions.method, description="`paper`: the recipe of the paper, slower.")
    hints: Hints | None = None
    cameras: Annotated[list[Camera], Field(min_length=1, max_length=MAX_IMAGES)] | None = Field(
        None,
        description="Cameras of the images: one entry for all, or one per image in their order. Without it, a 2:1 "
        "image is a full sphere; for other images the camera comes from GPano fields or the EXIF focal length in 35 "
        "mm terms. Several images need one entry each, with `session_from_camera`.",
    )
    session: TrackedSession | None = Field(None, description="Accuracy and up axis of `session_from_camera`.")
    artifacts: list[Artifact] = Field(default_factory=list, max_length=len(ARTIFACTS), description="Pictures to draw.")
    top_k: int = Field(
        QueryOptions.top_k,
        strict=True,
        ge=1,
        le=MAX_TOP_K,
        description="Largest number of poses: the pose and up to `top_k` − 1 alternatives; `ambiguous` always lists "
        "its rivals.",
    )
    timeout_s: Annotated[float, Field(gt=0)] | None = Field(
        None, description="Seconds for the answer, then 504; null: the service's default, which is longer for `paper`."
    )

    def to_options(self, timeout_s: float) -> QueryOptions:
        """Return the options for the worker. timeout_s: the default."""
        return QueryOptions(
            timeout_s=timeout_s if self.timeout_s is None else self.timeout_s,
            method=self.method,
            frame=self.frame,
            session=SessionOptions() if self.session is None else self.session.to_options(),
            hints=None if self.hints is None else self.hints.to_options(),
            artifacts=tuple(dict.fromkeys(self.artifacts)),
            top_k=self.top_k,
        )


class PendingLocalization(ResponseModel):
    """A query with `Prefer: respond-async` that has no answer yet, or has failed."""

    id: str
    status: Literal["queued", "running", "failed"]
    created_at: datetime
    error: ProblemDocument | None = Field(description="Reason of a failure; null otherwise.")
