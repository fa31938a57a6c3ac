"""Cameras of a query, and the poses that the device tracked."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from panoloc.core.camera.camera import CAMERA_MODELS, CameraDescription, CameraModel
from panoloc.core.errors import OptionsError
from panoloc.core.options import (
    MAX_ORIENTATION_NOISE_DEG,
    MAX_POSITION_NOISE_M,
    QUATERNION_TOLERANCE,
    SessionOptions,
    TrackedPose,
)
from panoloc.service.http.schemas.geometry import Coordinate, RequestModel

_Pixels = Annotated[int, Field(ge=1, le=65_535)]
_Number = Annotated[float, Field(strict=True)]  # neither text nor `true`, which would be one degree


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
    fx_px: _Number | None = Field(
        None, description="Focal length; for `cylindrical` and `equirectangular` horizontal pixels per radian."
    )
    fy_px: _Number | None = Field(None, description="Default: `fx_px`.")
    cx_px: _Number | None = Field(None, description="Default: the middle.")
    cy_px: _Number | None = Field(None, description="Default: the middle.")
    distortion: list[_Number] = Field(
        default_factory=list,
        max_length=8,
        description="`k1 k2 p1 p2 [k3 [k4 k5 k6]]`, or `k1 k2 k3 k4` of the fisheye.",
    )
    hfov_deg: _Number | None = Field(None, description="Horizontal field of view, instead of `fx_px` … `cy_px`.")
    hfov_range_deg: tuple[_Number, _Number] | None = Field(
        None,
        description="Bounds of an unknown field of view of a single `pinhole` photo, such as `[45, 85]`. The search takes several times as "
        "long; `images[0].camera` in the answer has the result.",
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
        given = self.model_dump(exclude={"session_from_camera"})
        if self.model is None:
            if any(value not in (None, []) for value in given.values()) or self.session_from_camera is None:
                raise OptionsError(
                    f"model: expected one of {', '.join(CAMERA_MODELS)}, got none; leave it out only if "
                    "session_from_camera is the only field"
                )
            return None
        return CameraDescription(**{**given, "distortion": tuple(self.distortion)})


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
