"""What a caller says of the camera that took an image."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from core.camera.camera import CAMERA_MODELS, CameraDescription, CameraModel
from core.errors import OptionsError
from service.http.schemas.geometry import Model
from service.http.schemas.session import SessionFromCamera

_Pixels = Annotated[int, Field(ge=1, le=65_535)]
_Number = Annotated[float, Field(strict=True)]  # neither text nor true, which would be one degree


class Camera(Model):
    """Intrinsics of the image `width_px` x `height_px`, of which the upload may be a resized copy; or its field of view.

    Pixel centres are half-integers: the centre of the top-left pixel is (0.5, 0.5).
    """

    model: CameraModel | None = Field(
        None,
        description="`pinhole`; `opencv` and `opencv_fisheye` with OpenCV's distortion; `cylindrical`, as phones make sweep panoramas; "
        "`equirectangular`, also a part of the sphere. Left out with all but the pose: the image says so itself.",
    )
    width_px: _Pixels | None = Field(None, description="Of the image that the intrinsics belong to.")
    height_px: _Pixels | None = None
    fx_px: _Number | None = Field(
        None, description="Focal length; of `cylindrical` and `equirectangular` pixels per radian across."
    )
    fy_px: _Number | None = Field(None, description="`fx_px` when left out.")
    cx_px: _Number | None = Field(None, description="The middle when left out.")
    cy_px: _Number | None = Field(None, description="The middle when left out.")
    distortion: list[_Number] = Field(
        default_factory=list,
        max_length=8,
        description="`k1 k2 p1 p2 [k3 [k4 k5 k6]]`, or `k1 k2 k3 k4` of the fisheye.",
    )
    hfov_deg: _Number | None = Field(
        None, description="Degrees from the left edge to the right one, in place of `fx_px` ... `cy_px`."
    )
    hfov_range_deg: tuple[_Number, _Number] | None = Field(
        None,
        description="Of a single `pinhole` photo whose field of view nobody knows: bounds within which it is searched, such as `[45, 85]`; "
        "takes several times as long. `images[0].camera` says what was found.",
    )
    session_from_camera: SessionFromCamera | None = Field(
        None, description="Where the image was taken; needed for each of several images."
    )

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        try:
            self.to_options()
        except OptionsError as error:
            raise ValueError(str(error)) from error
        return self

    def to_options(self) -> CameraDescription | None:
        """Return the camera as the algorithm takes it; None: the image says so itself. Raises OptionsError for what describes none."""
        given = self.model_dump(exclude={"session_from_camera"})
        if self.model is None:
            if any(value not in (None, []) for value in given.values()) or self.session_from_camera is None:
                raise OptionsError(
                    f"model: expected one of {', '.join(CAMERA_MODELS)}, got none; leave it out only where nothing but "
                    "session_from_camera is sent"
                )
            return None
        return CameraDescription(**{**given, "distortion": tuple(self.distortion)})
