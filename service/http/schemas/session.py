"""What a caller says of a session: where its images were taken, and what is known of these poses."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from core.options import (
    MAX_ORIENTATION_NOISE_DEG,
    MAX_POSITION_NOISE_M,
    QUATERNION_TOLERANCE,
    SessionOptions,
    TrackedPose,
)
from service.http.schemas.geometry import Coordinate, Model


class SessionPosition(Model):
    """Metres, in the session."""

    x: Coordinate
    y: Coordinate
    z: Coordinate


class SessionQuaternion(Model):
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


class SessionFromCamera(Model):
    """x_session = rotation · x_camera + position, as the device's own tracking gives it, in the axes of `frame`."""

    position_m: SessionPosition
    quaternion: SessionQuaternion

    def to_options(self) -> TrackedPose:
        """Return the pose as workers take it, its quaternion normalised."""
        position, turned = self.position_m, self.quaternion
        norm = math.hypot(turned.x, turned.y, turned.z, turned.w)
        return TrackedPose(
            (position.x, position.y, position.z),
            (turned.x / norm, turned.y / norm, turned.z / norm, turned.w / norm),
        )


class TrackedSession(Model):
    """What is known of the poses of the images among each other."""

    up: Literal["known", "unknown"] = Field(
        "unknown",
        description="`known`: the session's up axis (y in `webxr` and `unity`, z in `ros` and `opencv`) is against gravity, as ARKit, "
        "ARCore and WebXR have it.",
    )
    position_noise_m: Annotated[float, Field(ge=0, le=MAX_POSITION_NOISE_M)] = Field(
        SessionOptions.position_noise_m,
        description="Standard deviation of the tracking from image to image; not used yet.",
    )
    orientation_noise_deg: Annotated[float, Field(ge=0, le=MAX_ORIENTATION_NOISE_DEG)] = Field(
        SessionOptions.orientation_noise_deg, description="The same of the orientation; not used yet."
    )

    def to_options(self) -> SessionOptions:
        """Return what workers have to know."""
        return SessionOptions(self.up == "known", self.position_noise_m, self.orientation_noise_deg)
