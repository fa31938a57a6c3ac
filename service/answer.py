"""The answer to a query: one model for workers, Redis, the routes, the OpenAPI document and the console's types.

A worker builds it (`panoloc.service.worker.answers`); the HTTP process adds waiting time and warnings
(`Localization.as_waited_for`).
"""

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from panoloc.core.camera.camera import CameraModel
from panoloc.core.options import Frame, Status
from panoloc.core.remarks import Reason, Remark

PlacedBy = Literal["engine", "hand"]
Document = dict[str, Any]
"""A JSON object, as it is stored or sent."""


class ResponseModel(BaseModel):
    """A model of a response. Later versions may add fields."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Position(ResponseModel):
    """Metres, in the map's own frame."""

    x: float
    y: float
    z: float


class Quaternion(ResponseModel):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float


class RigidMotion(ResponseModel):
    """x_to = rotation · x_from + position: `map_from_camera` or `map_from_session`."""

    position_m: Position
    quaternion: Quaternion
    matrix: list[list[float]] = Field(description="4 x 4, row by row.", min_length=4, max_length=4)


class PoseAnswer(ResponseModel):
    """Position and orientation of the camera: as rotations about its axes, and as heading, elevation and roll."""

    frame: Frame
    map_from_camera: RigidMotion
    yaw_deg: float = Field(description="Counter-clockwise about z from the map's x axis, -180 to 180.")
    pitch_deg: float = Field(description="Positive if the camera looks down.")
    roll_deg: float
    heading_deg: float = Field(description="Of the image centre, clockwise from `north`, 0 to 360.", ge=0, lt=360)
    elevation_deg: float = Field(description="Of the image centre, positive above the horizon.", ge=-90, le=90)
    camera_roll_deg: float = Field(description="Positive if the camera's right side is down.")
    north: Literal["map", "true"] = Field(
        description="Zero direction of `heading_deg`: the map's y axis, or true north if the map has a georeference."
    )


class GeoPosition(ResponseModel):
    """WGS 84."""

    lat: float = Field(description="Degrees.")
    lon: float
    h: float = Field(description="Metres above the ellipsoid.")


class GeoPose(ResponseModel):
    """OGC GeoPose 1.0, Basic-Quaternion: from camera axes (x forward, y left, z up) to east, north, up."""

    position: GeoPosition
    quaternion: Quaternion


class Accuracy(ResponseModel):
    """Radius that contains the pose with probability `level`."""

    position_m: float | None
    orientation_deg: float | None
    level: float


class Alternative(ResponseModel):
    """Another possible pose."""

    pose: PoseAnswer
    confidence: float
    map_id: str = Field(description="The map of the pose.")


class Change(ResponseModel):
    """Differing share of scan and panorama."""

    panorama_changed_fraction: float | None
    map_changed_fraction: float | None


class ImageCamera(ResponseModel):
    """The camera that was used for an image."""

    model: CameraModel
    hfov_deg: float = Field(description="Horizontal field of view; 360: a full panorama, or a full turn.")


class ImageAnswer(ResponseModel):
    """One image of the query."""

    pose: PoseAnswer | None = Field(description="Pose of the image; null if the query is `not_localized`.")
    agreement: float | None = Field(
        description="Correlation of the image with the scan rendered at its pose, -1 to 1; for the best guess if the "
        "query is `not_localized`; null if unknown."
    )
    camera: ImageCamera


class Localization(ResponseModel):
    """The answer to a query. A panorama that fits no pose is `not_localized` with `pose: null`, not an error."""

    id: str
    status: Status
    placed_by: PlacedBy = Field(
        "engine", description="`hand`: a person has placed the photo, see `POST /batches/{id}/images/{number}/pose`."
    )
    map_id: str | None
    map_revision: int | None
    pose: PoseAnswer | None = Field(description="Of the first image.")
    map_from_session: RigidMotion | None = Field(
        description="x_map = rotation · x_session + position, both sides in the axes of `frame`. For one image "
        "without a pose, the session frame is the camera frame. Null if the query is `not_localized`."
    )
    images: list[ImageAnswer] = Field(description="One per image, in their order.")
    geopose: GeoPose | None = Field(
        description="OGC GeoPose 1.0, Basic-Quaternion, of the first image: camera x forward, y left, z up. Null "
        "without a pose, for a map without a georeference, and if its heights are not above the ellipsoid."
    )
    confidence: float = Field(ge=0, le=1, description="Probability that the pose is within 0.3 m and 10 degrees.")
    accuracy: Accuracy | None
    alternatives: list[Alternative]
    change: Change
    timings_s: dict[str, float] = Field(description="Seconds per stage; `queue` and `total` as the caller sees them.")
    search: dict[str, Any]
    warnings: list[str] = Field(description="For people.")
    reasons: list[Reason] = Field(
        default_factory=list, description="For programs: what each of `warnings` says, or what the caller can do."
    )
    artifacts: dict[str, str] = Field(description="Paths of the requested pictures.")

    def with_remarks(self, remarks: Iterable[Remark]) -> "Localization":
        """Return the answer with more warnings."""
        more = list(remarks)
        warnings, reasons = [*self.warnings, *more], [*self.reasons, *(each.reason for each in more)]
        return self.model_copy(update={"warnings": warnings, "reasons": reasons})

    def as_waited_for(self, total_s: float, remarks: Iterable[Remark]) -> "Localization":
        """Return the answer with the waiting time and the warnings of the HTTP process.

        total_s: seconds that the caller waited; `queue` is the part that the worker did not use.
        """
        stages = {name: seconds for name, seconds in self.timings_s.items() if name != "total"}
        waited_s = max(0.0, total_s - self.timings_s.get("total", sum(stages.values())))
        timings_s = {"queue": round(waited_s, 6), **stages, "total": round(total_s, 6)}
        return self.with_remarks(remarks).model_copy(update={"timings_s": timings_s})

    def without_copies(self) -> "Localization":
        """Return the answer without links to pictures, for a Redis that cannot keep them."""
        words = "Redis cannot store this answer: it cannot be fetched again, and its pictures are lost; localize again to get them"
        return self.with_remarks([Remark("not_kept", words)]).model_copy(update={"artifacts": {}})


class PlacedLocalization(Localization):
    """An answer with a pose."""

    map_id: str
    map_revision: int
    pose: PoseAnswer = Field(description="Of the first image.")
    map_from_session: RigidMotion = Field(
        description="x_map = rotation · x_session + position, both sides in the axes of `frame`. For one image "
        "without a pose, the session frame is the camera frame."
    )
    accuracy: Accuracy


class Localized(PlacedLocalization):
    """One pose fits."""

    status: Literal["localized"]


class Ambiguous(PlacedLocalization):
    """Several places look the same; those that are not the best are `alternatives`."""

    status: Literal["ambiguous"]


class NotLocalized(Localization):
    """No pose fits well enough. The best guess, if there is one, is the first of `alternatives`."""

    status: Literal["not_localized"]
    map_id: None
    map_revision: None
    pose: None
    map_from_session: None
    geopose: None
    accuracy: None


BY_STATUS = (Localized, Ambiguous, NotLocalized)
"""What an answer is, by its status, as the document of the API has it."""


def picture_path(localization_id: str, name: str) -> str:
    """Return the path of one PNG of an answer."""
    return f"/localizations/{localization_id}/{name.replace('_', '-')}.png"
