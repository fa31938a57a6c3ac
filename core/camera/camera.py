"""What a caller says of a camera, checked: model, size, intrinsics.

Plain numbers alone, so that the HTTP process can make one without loading what computes.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

from panoloc.core.errors import OptionsError

CameraModel = Literal["equirectangular", "pinhole", "opencv", "opencv_fisheye", "cylindrical"]
CAMERA_MODELS: tuple[CameraModel, ...] = get_args(CameraModel)

_MAX_SIDE_PX = 65_535
# Between an upload and the image that the intrinsics belong to: a row more or less of a small copy.
_MAX_ASPECT_ERROR = 0.01
MAX_HFOV_DEG = {"pinhole": 170.0, "opencv": 170.0}
"""Degrees across that a model can show, 360 where it is not named; a pinhole's image would be infinite at 180."""
_MOST_FOCAL_LENGTHS = 2 * math.tan(math.radians(MAX_HFOV_DEG["pinhole"] / 2)) * 1.001  # that a pinhole's image is wide
# Of what is searched: every step of the focal length is a search of its own.
MIN_UNKNOWN_HFOV_DEG, MAX_UNKNOWN_HFOV_DEG = 20.0, 120.0
# How many coefficients each model takes, in OpenCV's order.
_NUM_COEFFICIENTS = {"opencv": (4, 5, 8), "opencv_fisheye": (4,)}


@dataclass(frozen=True)
class Camera:
    """A calibrated camera: `width_px` x `height_px` is the image that the numbers belong to, pixel centres at half-integers.

    fx_px, fy_px: focal lengths; of a cylinder and a crop of an equirectangular image pixels per radian across (and, of the latter, down).
    cx_px, cy_px: the pixel that looks along the optical axis (x forward). distortion: OpenCV's `k1 k2 p1 p2 [k3 [k4 k5 k6]]`, or
    `k1 k2 k3 k4` of its fisheye.
    """

    model: CameraModel
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in CAMERA_MODELS:
            raise OptionsError(f"model: expected one of {', '.join(CAMERA_MODELS)}, got {self.model!r}")
        for name in ("width_px", "height_px"):
            if not 1 <= getattr(self, name) <= _MAX_SIDE_PX:
                raise OptionsError(f"{name}: expected 1 to {_MAX_SIDE_PX:,} pixels, got {getattr(self, name)}")
        for name in ("fx_px", "fy_px"):
            if not 0 < getattr(self, name) < math.inf:
                raise OptionsError(f"{name}: expected a positive number of pixels, got {getattr(self, name)}")
        if self.model in ("pinhole", "opencv") and self.width_px / self.fx_px > _MOST_FOCAL_LENGTHS:
            raise OptionsError(
                f"fx_px: expected an image of at most {MAX_HFOV_DEG[self.model]:g} degrees, {self.width_px} px wide, got a focal length "
                f"of {self.fx_px:g} px; check that it is in pixels, not in millimetres or fractions of the width"
            )
        for name, side in (("cx_px", self.width_px), ("cy_px", self.height_px)):
            if not -side <= getattr(self, name) <= 2 * side:
                raise OptionsError(
                    f"{name}: expected a pixel of the image, or one at most its size ({side} px) outside, got "
                    f"{getattr(self, name)}"
                )
        allowed = _NUM_COEFFICIENTS.get(self.model, ())
        if self.distortion and len(self.distortion) not in allowed:
            many = f"{' or '.join(map(str, allowed))} coefficients" if allowed else "none"
            hint = "" if allowed else "; use opencv or opencv_fisheye for distortion"
            raise OptionsError(f"distortion: expected {many} for {self.model}, got {len(self.distortion)}{hint}")
        if not all(math.isfinite(value) for value in self.distortion):
            raise OptionsError(f"distortion: expected finite numbers, got {list(self.distortion)}")

    @classmethod
    def from_hfov(cls, model: CameraModel, width_px: int, height_px: int, hfov_deg: float) -> "Camera":
        """Return the camera without distortion whose image is `hfov_deg` degrees wide, with square pixels, its axis through the middle."""
        largest = MAX_HFOV_DEG.get(model, 360.0)
        if not 1 <= hfov_deg <= largest:  # also false for NaN
            hint = "; send a sweep as cylindrical, a fisheye as opencv_fisheye" if largest < hfov_deg <= 360 else ""
            raise OptionsError(f"hfov_deg: expected 1 to {largest:g} degrees for {model}, got {hfov_deg:g}{hint}")
        half = math.radians(hfov_deg) / 2
        focal_px = width_px / 2 / (math.tan(half) if model in ("pinhole", "opencv") else half)
        return cls(model, width_px, height_px, focal_px, focal_px, width_px / 2, height_px / 2)

    def solid_angle(self, factor: float = 1.0) -> float:
        """Return the solid angle (steradian) that the camera would see without distortion, its focal length longer by a factor."""
        width, height = self.width_px / (2 * factor * self.fx_px), self.height_px / (2 * factor * self.fy_px)
        return 4 * math.asin(width * height / math.sqrt((1 + width**2) * (1 + height**2)))

    @property
    def hfov_deg(self) -> float:
        """Return about how wide the image is, degrees, leaving distortion aside."""
        left, right = self.cx_px / self.fx_px, (self.width_px - self.cx_px) / self.fx_px
        if self.model in ("pinhole", "opencv"):
            left, right = math.atan(left), math.atan(right)
        return min(math.degrees(left + right), 360.0)

    @property
    def is_whole_sphere(self) -> bool:
        """Return whether the image is a full sphere: twice as wide as high, all around."""
        return (
            self.model == "equirectangular"
            and abs(self.width_px - 2 * math.pi * self.fx_px) < 1
            and abs(self.height_px - math.pi * self.fy_px) < 1
            and abs(2 * self.cx_px - self.width_px) < 1
            and abs(2 * self.cy_px - self.height_px) < 1
        )

    def resized(self, width_px: int, height_px: int) -> "Camera":
        """Return the camera of a resized copy of the image. Raises OptionsError where the copy has another shape."""
        if not have_one_shape((self.width_px, self.height_px), (width_px, height_px)):
            raise OptionsError(
                f"cameras: expected an image of width_px x height_px, {self.width_px} x {self.height_px} px, or a "
                f"resized copy of it, got {width_px} x {height_px}; send size and intrinsics of the uploaded image"
            )
        across, down = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * across,
            fy_px=self.fy_px * down,
            cx_px=self.cx_px * across,
            cy_px=self.cy_px * down,
        )


@dataclass(frozen=True)
class CameraDescription:
    """What a caller says of the camera of an image: intrinsics of an image of a given size, or a field of view.

    width_px, height_px: the image that fx_px ... cy_px belong to; None: the image as it is uploaded. fx_px ... cy_px, or hfov_deg in their
    place; fy_px: as fx_px where it is None; cx_px, cy_px: the middle. A full equirectangular image needs none of them. hfov_range_deg: of a
    pinhole whose field of view is not known, bounds within which it is searched. unless_panorama: of many images, those that
    are twice as wide as high or have GPano fields are read as panoramas, as if nothing was described.
    Raises OptionsError for numbers that describe no camera.
    """

    model: CameraModel
    width_px: int | None = None
    height_px: int | None = None
    fx_px: float | None = None
    fy_px: float | None = None
    cx_px: float | None = None
    cy_px: float | None = None
    distortion: tuple[float, ...] = ()
    hfov_deg: float | None = None
    hfov_range_deg: tuple[float, float] | None = None
    unless_panorama: bool = False

    def __post_init__(self) -> None:
        if self.model not in CAMERA_MODELS:
            raise OptionsError(f"model: expected one of {', '.join(CAMERA_MODELS)}, got {self.model!r}")
        if (self.width_px is None) != (self.height_px is None):
            raise OptionsError(
                "width_px and height_px: expected both or neither; they give the size of the image to which the "
                "intrinsics belong"
            )
        if self.fx_px is not None and self.hfov_deg is not None:
            raise OptionsError(
                "hfov_deg: expected either fx_px with the other intrinsics, or hfov_deg, got both; leave one out"
            )
        if self.hfov_range_deg is not None:
            self._check_range(self.hfov_range_deg)
        elif self.fx_px is None and self.hfov_deg is None and self.model != "equirectangular":
            raise OptionsError(
                f"fx_px: expected the intrinsics of a {self.model} camera, or hfov_deg, got neither; for an unknown "
                "field of view send model pinhole and hfov_range_deg"
            )
        if self.fx_px is not None and self.width_px is None:
            raise OptionsError(
                "width_px: expected width_px and height_px of the image to which the intrinsics belong, got none"
            )
        self._camera(self.width_px or 2000, self.height_px or 1000)

    def _check_range(self, bounds_deg: tuple[float, float]) -> None:
        least, most = bounds_deg
        if self.model != "pinhole" or self.fx_px is not None or self.hfov_deg is not None:
            raise OptionsError(
                "hfov_range_deg: expected only with model pinhole, in place of fx_px or hfov_deg; leave the others out"
            )
        if not MIN_UNKNOWN_HFOV_DEG <= least < most <= MAX_UNKNOWN_HFOV_DEG:  # also false for NaN
            raise OptionsError(
                f"hfov_range_deg: expected two rising numbers from {MIN_UNKNOWN_HFOV_DEG:g} to {MAX_UNKNOWN_HFOV_DEG:g} degrees, "
                f"got {least:g} and {most:g}"
            )

    @property
    def focal_uncertainty(self) -> float:
        """Return the share that the focal length may be off by (68 %): intrinsics are measured, a field of view is rounded to a degree."""
        return 0.0 if self.hfov_deg is None else math.radians(0.34) / math.sin(math.radians(min(self.hfov_deg, 90.0)))

    def is_as_stored(self, stored: tuple[int, int]) -> bool:
        """Tell whether the description is of an image (width, height) as it is stored, before EXIF turns it: sensors have no upright."""
        return (
            self.width_px is not None
            and self.height_px is not None
            and have_one_shape((self.width_px, self.height_px), stored)
        )

    def of_image(self, stored: tuple[int, int], turned: tuple[int, int]) -> Camera:
        """Return the camera of an image whose size (width, height) is `stored` in the file and `turned` as EXIF shows it.

        Raises OptionsError where the description is of an image of another shape than both.
        """
        if self.width_px is None or self.height_px is None:
            return self._camera(*turned)
        return self._camera(self.width_px, self.height_px).resized(*(stored if self.is_as_stored(stored) else turned))

    def _camera(self, width_px: int, height_px: int) -> Camera:
        if self.hfov_range_deg is not None:
            tangents = [math.tan(math.radians(width) / 2) for width in self.hfov_range_deg]
            middle_deg = math.degrees(2 * math.atan(math.sqrt(tangents[0] * tangents[1])))
            return Camera.from_hfov(self.model, width_px, height_px, middle_deg)
        if self.fx_px is None:
            # Also a full sphere, of which nothing has to be said.
            made = Camera.from_hfov(self.model, width_px, height_px, 360.0 if self.hfov_deg is None else self.hfov_deg)
            return replace(made, distortion=self.distortion)
        return Camera(
            self.model,
            width_px,
            height_px,
            self.fx_px,
            self.fx_px if self.fy_px is None else self.fy_px,
            width_px / 2 if self.cx_px is None else self.cx_px,
            height_px / 2 if self.cy_px is None else self.cy_px,
            self.distortion,
        )


def have_one_shape(first: tuple[int, int], second: tuple[int, int]) -> bool:
    """Tell whether two sizes (width, height) can be of resized copies of one image."""
    across, down = second[0] / first[0], second[1] / first[1]
    return abs(across / down - 1) <= _MAX_ASPECT_ERROR + 1 / min(second)
