"""Models of the GeoPoseProtocol of OSCP (version 2) and of the protocol of OpenFLAME."""

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from panoloc.core.errors import OptionsError
from panoloc.core.image.image_header import KNOWN_FORMATS
from panoloc.service.answer import GeoPose, ResponseModel
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.schemas.queries import Camera

_DEPTH = "DEPTH"
_READINGS = "sensorReadings.cameraReadings"
# COLMAP's names. The first numbers are so many focal lengths; the centre and the distortion follow.
_FOCAL_LENGTHS = {"SIMPLE_PINHOLE": 1, "PINHOLE": 2, "SIMPLE_RADIAL": 1, "RADIAL": 1, "OPENCV": 2, "FULL_OPENCV": 2}
_FISHEYE = "OPENCV_FISHEYE"
# Sent by clients that do not know the camera, of version 2 and earlier.
_NO_CAMERA = ("", "UNKNOWN", "UNKNOWN_CAMERA")
_SPHERES = ("EQUIRECTANGULAR", "SPHERICAL")


class GeoPoseAccuracy(ResponseModel):
    """Radii that hold 68 %."""

    position: float = Field(description="Metres.")
    orientation: float = Field(description="Degrees.")


class GeoPoseReply(ResponseModel):
    """A response of the GeoPoseProtocol."""

    id: str
    timestamp: int = Field(description="Milliseconds since 1970.")
    type: Literal["geopose"]
    accuracy: GeoPoseAccuracy
    geopose: GeoPose


class _Lenient(BaseModel):
    """Requests of any client of the protocol: only the image is required, unknown fields are ignored."""

    # `{}` is open as `true` is, but stays in the document of the API.
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, json_schema_extra={"additionalProperties": {}})


class CameraParameters(_Lenient):
    """Intrinsics by COLMAP's names."""

    model: str | None = Field(None, max_length=40, description="Such as PINHOLE, OPENCV or EQUIRECTANGULAR.")
    modelParams: Annotated[list[float], Field(max_length=16)] | None = None  # noqa: N815


class ImageOrientation(_Lenient):
    """How to turn an image upright."""

    mirrored: bool = False
    rotation: float = 0.0


class CameraReading(_Lenient):
    """One image."""

    imageBytes: str = Field(description=f"A {KNOWN_FORMATS} file as base64.")  # noqa: N815
    imageFormat: str | None = Field(None, max_length=40, description="`DEPTH`: the image is ignored.")  # noqa: N815
    size: Annotated[list[int], Field(max_length=4)] | None = Field(None, description="Width and height of `params`.")
    imageOrientation: ImageOrientation | None = None  # noqa: N815
    params: CameraParameters | None = None

    def camera(self) -> Camera | None:
        """Return the camera; None: from the image's metadata. Raises InvalidOptionsError."""
        turned = self.imageOrientation
        if turned is not None and (turned.mirrored or turned.rotation % 360 != 0):
            raise InvalidOptionsError.of(
                f"{_READINGS}.imageOrientation",
                "expected an upright image, got a rotated or mirrored one; rotate it first",
            )
        model = (self.params.model if self.params and self.params.model else "").upper()
        if model in _NO_CAMERA:
            return None
        if model in _SPHERES:
            return Camera(model="equirectangular")
        try:
            return Camera.model_validate(_intrinsics(model, (self.params and self.params.modelParams) or [], self.size))
        except (OptionsError, ValueError) as error:
            raise InvalidOptionsError.of(f"{_READINGS}.params", f"expected a valid camera, but {error}") from error


class GeolocationReading(_Lenient):
    """Position that the device reports."""

    latitude: float | None = Field(None, ge=-90, le=90)
    longitude: float | None = Field(None, ge=-180, le=180)
    accuracy: float | None = Field(None, ge=0, description="Metres.")


class SensorReadings(_Lenient):
    """Readings of the device's sensors."""

    cameraReadings: Annotated[list[CameraReading], Field(min_length=1, max_length=8)]  # noqa: N815
    # The published client of version 2 writes a capital L; the schema and the text of the protocol do not.
    geolocationReadings: Annotated[list[GeolocationReading], Field(max_length=100)] | None = Field(  # noqa: N815
        None, validation_alias=AliasChoices("geolocationReadings", "geoLocationReadings")
    )

    def image(self) -> CameraReading:
        """Return the single image. Raises InvalidOptionsError for several: sessions go to `POST /localize`."""
        images = [each for each in self.cameraReadings if (each.imageFormat or "").upper() != _DEPTH]
        if len(images) != 1:
            raise InvalidOptionsError.of(
                _READINGS, f"expected one image besides depth, got {len(images)}; send one image, or use POST /localize"
            )
        return images[0]


class GeoPoseRequest(_Lenient):
    """A request of the GeoPoseProtocol of OSCP, version 2."""

    id: str | None = Field(None, max_length=200)
    type: str | None = Field(None, max_length=40)
    sensorReadings: SensorReadings  # noqa: N815


class OpenFlameAnswer(ResponseModel):
    """A response of an OpenFLAME map server."""

    success: bool
    pose: list[list[float]] | None = Field(
        description="4 x 4, row by row: from the camera (x right, y up, z backward) to the world of A-Frame (y, z, x of the map)."
    )
    confidence: float = Field(ge=0, le=1)


class OpenFlameCapabilities(ResponseModel):
    """Capabilities of an OpenFLAME map server."""

    commonName: str  # noqa: N815
    iconURL: str  # noqa: N815
    services: list[dict[str, Any]]


def _intrinsics(model: str, numbers: list[float], size: list[int] | None) -> dict[str, Any]:
    num_focal = 2 if model == _FISHEYE else _FOCAL_LENGTHS.get(model)
    if num_focal is None or len(numbers) < num_focal + 2:
        raise OptionsError(
            f"expected {', '.join((*_FOCAL_LENGTHS, _FISHEYE))} or EQUIRECTANGULAR with its numbers, got {model!r} with {len(numbers)}"
        )
    if size is None or len(size) < 2:
        raise OptionsError(
            "expected the size of the image to which the numbers belong, got none; send size: [width, height]"
        )
    focal, (cx, cy), distortion = numbers[:num_focal], numbers[num_focal:][:2], numbers[num_focal + 2 :]
    if model in ("SIMPLE_RADIAL", "RADIAL"):
        # Radial terms alone: OpenCV has the tangential ones after the second.
        distortion = [*distortion[:2], *([0.0] * (4 - len(distortion[:2])))]
    kind = "opencv_fisheye" if model == _FISHEYE else "opencv" if any(distortion) else "pinhole"
    return {
        "model": kind,
        "width_px": size[0],
        "height_px": size[1],
        "fx_px": focal[0],
        "fy_px": focal[-1],
        "cx_px": cx,
        "cy_px": cy,
        "distortion": distortion if kind != "pinhole" else [],
    }
