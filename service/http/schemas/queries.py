"""Queries: cameras, the poses that the device tracked, hints and options; and a query whose answer is fetched later."""

import math
from datetime import datetime
from typing import Annotated, Literal, Self, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from panoloc.core import options
from panoloc.core.camera.camera import CAMERA_MODELS, CameraDescription, CameraModel
from panoloc.core.errors import OptionsError
from panoloc.core.options import (
    DEFAULT_RADIUS_M,
    DEFAULT_TOLERANCE_DEG,
    FARTHEST_M,
    MAX_IMAGES,
    MAX_ORIENTATION_NOISE_DEG,
    MAX_POSITION_NOISE_M,
    MAX_TOP_K,
    QUATERNION_TOLERANCE,
    Frame,
    Method,
    SessionOptions,
    TrackedPose,
)
from panoloc.service.answer import ResponseModel
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.jobs import ARTIFACTS, Artifact, QueryOptions

MAX_PRIOR_STD_M, MAX_PRIOR_STD_DEG = 10.0, 60.0
Coordinate = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M, allow_inf_nan=False)]
Vector = Annotated[list[Coordinate], Field(min_length=3, max_length=3, description="x, y, z")]


class RequestModel(BaseModel):
    """A model of a request. Unknown fields are errors, so that a misspelt one is not ignored; so are values of other types, such as "no",
    or `true` for a number, which would be one degree."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class Box(RequestModel):
    """A box along the axes of the map's own frame, metres."""

    min: Vector
    max: Vector

    def to_options(self) -> options.Box:
        """Return the box for the worker."""
        return cast(options.Box, (tuple(self.min), tuple(self.max)))


def _has_volume(box: Box) -> Box:
    if not all(low < high for low, high in zip(box.min, box.max, strict=True)):
        raise ValueError(f"expected min below max on every axis, got min {box.min} and max {box.max}")
    return box


Region = Annotated[Box, AfterValidator(_has_volume)]


_Pixels = Annotated[int, Field(ge=1, le=65_535)]


class SessionPosition(RequestModel):
    """Metres, in the session."""

    x: Coordinate
    y: Coordinate
    z: Coordinate


class SessionQuaternion(RequestModel):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float

    @model_validator(mode="after")
    def _is_unit(self) -> Self:
        norm = math.hypot(self.x, self.y, self.z, self.w)
        if not abs(norm - 1) <= QUATERNION_TOLERANCE:
            raise ValueError(
                f"expected a unit quaternion {{x, y, z, w}}, got one of norm {norm:.4g}; send the rotation of the pose, w last"
            )
        return self


class SessionFromCamera(RequestModel):
    """x_session = rotation · x_camera + position, from the device's own tracking, in the axes of `frame`."""

    position_m: SessionPosition
    quaternion: SessionQuaternion

    def to_options(self) -> TrackedPose:
        """Return the pose for the worker, with its quaternion normalised."""
        position, turned = self.position_m, self.quaternion
        norm = math.hypot(turned.x, turned.y, turned.z, turned.w)
        return TrackedPose(
            (position.x, position.y, position.z),
            (turned.x / norm, turned.y / norm, turned.z / norm, turned.w / norm),
        )


class Camera(RequestModel):
    """Intrinsics of an image of `width_px` x `height_px`, or a field of view.

    The upload may be a resized copy of that image.

    Pixel centres are half-integers: the centre of the top-left pixel is (0.5, 0.5).
    """

    model: CameraModel | None = Field(
        None,
        description="`pinhole`; `opencv` and `opencv_fisheye` with OpenCV's distortion; `cylindrical` for the sweep "
        "panoramas of phones; `equirectangular`, also a part of the sphere. With `session_from_camera` alone, the "
        "camera comes from the image's metadata.",
    )
    width_px: _Pixels | None = Field(None, description="Width of the image to which the intrinsics belong.")
    height_px: _Pixels | None = None
    fx_px: float | None = Field(
        None, description="Focal length; for `cylindrical` and `equirectangular` horizontal pixels per radian."
    )
    fy_px: float | None = Field(None, description="Default: `fx_px`.")
    cx_px: float | None = Field(None, description="Default: the middle.")
    cy_px: float | None = Field(None, description="Default: the middle.")
    distortion: list[float] = Field(
        default_factory=list,
        max_length=8,
        description="`k1 k2 p1 p2 [k3 [k4 k5 k6]]`, or `k1 k2 k3 k4` of the fisheye.",
    )
    hfov_deg: float | None = Field(None, description="Horizontal field of view, instead of `fx_px` … `cy_px`.")
    hfov_range_deg: Annotated[list[float], Field(min_length=2, max_length=2)] | None = Field(
        None,
        description="Bounds of an unknown field of view of `pinhole` photos, such as `[45, 85]`, the same for all images. The search takes "
        "several times as long; `images[…].camera` in the answer has the result.",
    )
    unless_panorama: bool = Field(
        False,
        description="Images that are twice as wide as high, or have GPano fields, are read as panoramas; the entry is for the others.",
    )
    session_from_camera: SessionFromCamera | None = Field(
        None, description="Tracked pose of the image; needed for each of several images."
    )

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        try:
            self.to_options()
        except OptionsError as error:
            raise ValueError(str(error)) from error
        return self

    def to_options(self) -> CameraDescription | None:
        """Return the camera for the worker; None: from the image's metadata. Raises OptionsError if it is not valid."""
        given = self.model_dump(exclude={"session_from_camera"}, exclude_defaults=True)
        if self.model is None:
            if given or self.session_from_camera is None:
                raise OptionsError(
                    f"model: expected one of {', '.join(CAMERA_MODELS)}, got none; leave it out only if "
                    "session_from_camera is the only field"
                )
            return None
        bounds = None if self.hfov_range_deg is None else tuple(self.hfov_range_deg)
        return CameraDescription(**{**given, "distortion": tuple(self.distortion), "hfov_range_deg": bounds})


class TrackedSession(RequestModel):
    """Accuracy and up axis of the tracked poses."""

    up: Literal["known", "unknown"] = Field(
        "unknown",
        description="`known`: the session's up axis (y in `webxr` and `unity`, z in `ros` and `opencv`) is opposite "
        "to gravity, as in ARKit, ARCore and WebXR.",
    )
    position_noise_m: Annotated[float, Field(ge=0, le=MAX_POSITION_NOISE_M)] = Field(
        SessionOptions.position_noise_m,
        description="Standard deviation of the tracked position between images; it widens `accuracy`.",
    )
    orientation_noise_deg: Annotated[float, Field(ge=0, le=MAX_ORIENTATION_NOISE_DEG)] = Field(
        SessionOptions.orientation_noise_deg,
        description="Standard deviation of the tracked orientation between images; it widens `accuracy`.",
    )

    def to_options(self) -> SessionOptions:
        """Return the options for the worker."""
        return SessionOptions(self.up == "known", self.position_noise_m, self.orientation_noise_deg)


class ExpectedMotion(BaseModel):
    """x_map = rotation · x_camera + position, in the axes of `frame`. Other fields of an answer are ignored."""

    # `{}` is open as `true` is, but stays in the document of the API.
    model_config = ConfigDict(
        extra="ignore", allow_inf_nan=False, strict=True, json_schema_extra={"additionalProperties": {}}
    )

    position_m: SessionPosition
    quaternion: SessionQuaternion


class ExpectedPose(BaseModel):
    """A pose in the form of an answer, such as its `pose`. Other fields of an answer are ignored."""

    model_config = ExpectedMotion.model_config

    frame: Frame
    map_from_camera: ExpectedMotion


class CameraMotion(SessionFromCamera):
    """x_then = rotation · x_now + position: the pose of the camera now in that of the camera then, both in the camera axes of `frame`."""


class Prior(RequestModel):
    """Where the first camera is expected: by its pose, or by an earlier answer and the motion since."""

    pose: ExpectedPose | None = Field(None, description="The expected pose.")
    localization_id: Annotated[str, Field(min_length=1, max_length=80)] | None = Field(
        None,
        description="Instead of `pose`: an earlier answer, `localized` in the same map and the same `frame`. Without `motion` the camera "
        "is where it was; or, if both queries have `session_from_camera`, where `map_from_session` of the answer puts it.",
    )
    motion: CameraMotion | None = Field(
        None,
        description="Of the first camera since that answer: from the first image of its query to the first image of this one.",
    )
    position_std_m: Annotated[float, Field(gt=0, le=MAX_PRIOR_STD_M)] | None = Field(
        None,
        description=f"Standard deviation of each coordinate; {options.PosePrior.position_std_m:g} by default. After a known motion: "
        "`accuracy` of the answer and a hundredth of the way.",
    )
    orientation_std_deg: Annotated[float, Field(gt=0, le=MAX_PRIOR_STD_DEG)] | None = Field(
        None,
        description=f"Standard deviation of the rotation about each axis; {options.PosePrior.orientation_std_deg:g} by default. After a "
        "known motion: `accuracy` of the answer and 0.1 degrees per metre of the way.",
    )
    only: bool = Field(
        False,
        description="Nothing is searched elsewhere: the answer is what fits best there, or, where that does not fit well enough, its first "
        "alternative.",
    )

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if (self.pose is None) == (self.localization_id is None):
            got = "neither" if self.pose is None else "both"
            raise ValueError(f"expected either pose or localization_id, got {got}; send one of them")
        if self.motion is not None and self.localization_id is None:
            raise ValueError("motion: expected together with localization_id; a pose has to include the motion")
        return self

    def to_options(self) -> options.PosePrior:
        """Return the prior for the worker. `pose`: has been filled in by `panoloc.service.http.query_images`."""
        assert self.pose is not None
        place, turned = self.pose.map_from_camera.position_m, self.pose.map_from_camera.quaternion
        return options.PosePrior(
            (place.x, place.y, place.z),
            (turned.x, turned.y, turned.z, turned.w),
            self.pose.frame,
            self.position_std_m or options.PosePrior.position_std_m,
            self.orientation_std_deg or options.PosePrior.orientation_std_deg,
            self.only,
        )


class Hints(RequestModel):
    """Prior knowledge of the caller. Every hint but `prior` narrows the search, and every answer satisfies it."""

    position_m: Vector | None = Field(None, description="Camera position in the map's own frame.")
    radius_m: Annotated[float, Field(gt=0, le=1e6)] | None = Field(
        None, description=f"Largest distance from `position_m`; {DEFAULT_RADIUS_M:g} by default."
    )
    region: Region | None = Field(None, description="Box around the camera in the map's own frame.")
    upright: bool | None = Field(None, description="The camera is level within `max_tilt_deg`.")
    max_tilt_deg: Annotated[float, Field(ge=0, le=180)] | None = Field(
        None, description=f"{DEFAULT_TOLERANCE_DEG:g} when only `upright` is given."
    )
    heading_deg: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None,
        description="Yaw of the image centre, counter-clockwise about z from +x: the `yaw_deg` of an answer, not its `heading_deg`.",
    )
    heading_tolerance_deg: Annotated[float, Field(gt=0, le=180)] | None = Field(
        None, description=f"{DEFAULT_TOLERANCE_DEG:g} by default."
    )
    prior: Prior | None = Field(
        None,
        description="A pose that is tried first, in a query of one map. It narrows nothing and may be wrong: where no answer is sure "
        "there, everything is searched, unless it is said to be the `only` one.",
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
        if self.prior is not None:
            given["prior"] = self.prior.to_options()
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
