"""A session: photos of known cameras, and the poses that the device's own tracking gives them among each other."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.panorama import Panorama
from panoloc.core.errors import PanoramaShapeError
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import SessionOptions


@dataclass(frozen=True)
class Photo:
    """An image of a known camera.

    color: (h, w, 3) uint8, RGB. valid: (h, w) bool, False where it is to be ignored. camera: of an image of exactly this size.
    left_out: as of a panorama. hfov_range_deg: where only bounds of the field of view are known; the camera is then a guess within them.
    focal_uncertainty: share of the focal length that it may be off by (68 %), as far as is known.
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
        """Return a full sphere as a photo, to be one of several."""
        height, width = panorama.valid.shape
        per_rad = width / (2 * math.pi)
        camera = Camera("equirectangular", width, height, per_rad, per_rad, width / 2, height / 2)
        return cls(panorama.color, panorama.valid, camera, panorama.left_out)


@dataclass(frozen=True)
class SessionImage:
    """One photo of a session, and where it was taken: x_session = R x_camera + t, camera x forward, y left, z up, metres."""

    photo: Photo
    session_from_camera: Pose


@dataclass(frozen=True)
class Session:
    """One to 32 photos that were taken from poses known among each other, right-handed, z up where `options.up_known`."""

    images: tuple[SessionImage, ...]
    options: SessionOptions = field(default_factory=SessionOptions)

    @classmethod
    def of_photo(cls, photo: Photo) -> "Session":
        """Return the session of one photo, whose own frame it is."""
        return cls((SessionImage(photo, Pose(np.eye(3), np.zeros(3))),))


def is_perspective(session: Session) -> bool:
    """Tell whether all photos are of cameras whose focal length spreads what is beside the optical axis."""
    return all(image.photo.camera.model in ("pinhole", "opencv") for image in session.images)


def with_focal_factor(session: Session, factor: float, uncertainty: float = 0.0) -> Session:
    """Return the session with cameras of longer focal lengths, by a factor, which may be off by a share; they are known then."""

    def scaled(photo: Photo) -> Photo:
        """Return a photo with such a camera."""
        camera = replace(photo.camera, fx_px=factor * photo.camera.fx_px, fy_px=factor * photo.camera.fy_px)
        return replace(photo, camera=camera, hfov_range_deg=None, focal_uncertainty=uncertainty)

    return replace(session, images=tuple(replace(image, photo=scaled(image.photo)) for image in session.images))


def session_from_rig(session: Session) -> Pose:
    """Return the pose of the rig of a session: its own axes, from the middle of its cameras."""
    return Pose(np.eye(3), np.mean([image.session_from_camera.position for image in session.images], axis=0))


def left_out(query: Panorama | Photo | Session) -> tuple[str, ...]:
    """Return, in words for people, what of a query's images was found not to be the place, and what they leave open of their cameras; of
    several by their number."""
    if not isinstance(query, Session):
        return query.left_out
    photos = [image.photo for image in query.images]
    if len(photos) == 1:
        return photos[0].left_out
    return tuple(f"image {number}: {words}" for number, photo in enumerate(photos, 1) for words in photo.left_out)
