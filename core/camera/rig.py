"""Panoramas, photos, and rigs: one or more cameras with poses among each other, and the image that each took.

A panorama is a rig of one camera that covers the sphere, a photo of one that covers a part, a session of several.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.errors import PanoramaShapeError
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import SessionOptions


@dataclass(frozen=True)
class Panorama:
    """A full-sphere equirectangular image.

    color: (H, W, 3) uint8, W = 2 H, RGB; row 0 looks up, the centre column looks forward (+x).
    valid: (H, W) bool; False marks pixels to ignore (missing, masked, outside a crop). Missing is a mask, never a colour.
    left_out: in words for people, what was found not to be the place, and is not valid for that.
    """

    color: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        height, width = self.valid.shape
        if self.color.shape != (height, width, 3) or width != 2 * height:
            raise PanoramaShapeError(
                f"panorama: expected color (H, 2H, 3) and valid (H, 2H), got {self.color.shape} and {self.valid.shape}"
            )


@dataclass(frozen=True)
class Photo:
    """An image of a known camera.

    color: (h, w, 3) uint8, RGB. valid: (h, w) bool, False where it is to be ignored. camera: of an image of exactly this size.
    left_out: in words for people, what was found to be an invalid region. hfov_range_deg: where only bounds of the field of view are
    known; the camera is then a guess within them. focal_uncertainty: share of the focal length that it may be off by (68 %).
    """

    color: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    camera: Camera
    left_out: tuple[str, ...] = ()
    hfov_range_deg: tuple[float, float] | None = None
    focal_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        size = (self.camera.height_px, self.camera.width_px)
        if self.valid.shape != size or self.color.shape != (*size, 3):
            raise PanoramaShapeError(
                f"photo: expected color (h, w, 3) and valid (h, w) of the camera's {size[1]} x {size[0]} pixels, "
                f"got {self.color.shape} and {self.valid.shape}"
            )

    @classmethod
    def of_panorama(cls, panorama: Panorama) -> "Photo":
        """Return a full sphere as the image of a camera that wraps."""
        height, width = panorama.valid.shape
        camera = Camera.from_hfov("equirectangular", width, height, 360.0)
        return cls(panorama.color, panorama.valid, camera, panorama.left_out)


@dataclass(frozen=True)
class RigImage:
    """One image of a rig, and where it was taken: x_session = R x_camera + t, camera x forward, y left, z up, metres."""

    photo: Photo
    session_from_camera: Pose


@dataclass(frozen=True)
class Rig:
    """One to 32 images that were taken from poses known among each other, right-handed, z up where `options.up_known`."""

    images: tuple[RigImage, ...]
    options: SessionOptions = field(default_factory=SessionOptions)

    @classmethod
    def of_photo(cls, photo: Photo) -> "Rig":
        """Return the rig of one image, whose own frame it is."""
        return cls((RigImage(photo, Pose(np.eye(3), np.zeros(3))),))

    @classmethod
    def of_panorama(cls, panorama: Panorama) -> "Rig":
        """Return the rig of one panorama."""
        return cls.of_photo(Photo.of_panorama(panorama))

    @property
    def photos(self) -> tuple[Photo, ...]:
        """Return the images without their poses."""
        return tuple(image.photo for image in self.images)

    @property
    def has_focal_length(self) -> bool:
        """Return whether all cameras have a focal length that spreads what is beside the optical axis."""
        return all(photo.camera.model in ("pinhole", "opencv") for photo in self.photos)

    @property
    def session_from_rig(self) -> Pose:
        """Return the pose of the rig's own axes: those of the session, from the middle of its cameras."""
        return Pose(np.eye(3), np.mean([image.session_from_camera.position for image in self.images], axis=0))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return, in words for people, the invalid regions of the images and what they leave open of their cameras; of several images by
        their number."""
        if len(self.images) == 1:
            return self.photos[0].left_out
        return tuple(
            f"image {number}: {words}" for number, photo in enumerate(self.photos, 1) for words in photo.left_out
        )

    @property
    def has_unsure_extent(self) -> bool:
        """Return whether this is one image of a camera without a focal length, of which only a field of view was stated. The width may be a
        guess then, and nobody said how much was cut off above and below."""
        photo, *others = self.photos
        is_described = photo.camera.hfov_deg < 360 or photo.camera.model == "equirectangular"
        is_known = photo.camera.is_whole_sphere or not photo.focal_uncertainty
        return is_described and not (others or is_known or self.has_focal_length)

    def with_other_extent(self, wider: float, higher: float) -> "Rig | None":
        """Return such an image where it shows another part of the sphere; None where there is no such part, or that is known.
        `Camera.from_hfov` puts the horizon in the middle.

        wider, higher: radians; how much more is shown on either side, and above the horizon instead of below.
        """
        camera = self.photos[0].camera
        has_horizon, is_round = camera.model in ("cylindrical", "equirectangular"), camera.hfov_deg >= 360
        half = math.radians(camera.hfov_deg) / 2
        if (wider and (is_round or not 0 < half + wider < math.pi)) or (higher and not has_horizon):
            return None
        height, row = camera.height_px, camera.cy_px + higher * camera.fy_px
        quarter = camera.fy_px * math.pi / 2 if camera.model == "equirectangular" else math.inf
        if not max(height - quarter - 0.5, -height) <= row <= min(quarter + 0.5, 2 * height):
            return None
        photo = replace(self.photos[0], camera=replace(camera, cy_px=row))
        moved = replace(self, images=(replace(self.images[0], photo=photo),))
        return moved.with_focal_factor(half / (half + wider)) if wider else moved

    def with_focal_factor(self, factor: float) -> "Rig":
        """Return the rig with cameras of longer focal lengths, by a factor."""

        def scaled(photo: Photo) -> Photo:
            """Return an image with such a camera."""
            camera = replace(photo.camera, fx_px=factor * photo.camera.fx_px, fy_px=factor * photo.camera.fy_px)
            return replace(photo, camera=camera)

        return replace(self, images=tuple(replace(image, photo=scaled(image.photo)) for image in self.images))
