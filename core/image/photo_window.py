"""Photos placed on the sphere: as a panorama in which all that they do not show is masked, or on the window that one fills.

The pose of the panorama of one photo is that of its camera: the optical axis goes through the middle of both.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image, share_with_direction
from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo, Rig
from panoloc.core.errors import OptionsError, PanoramaUnusableError
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.image_on_sphere import LARGEST_STEP, image_towards, resized_image

FINEST_ROWS = 1024  # of the sphere on which photos are looked at
EXTENT_ROWS = 128  # of the sphere on which the extent of a photo is looked for
_COARSEST_ROWS = 16  # windows begin and end at whole pixels of a sphere of so many rows
_MIN_SIDE = 16  # pixels
_MIN_WITH_DIRECTION = 0.5  # of a photo; of real lenses nearly all of it has one
_MIN_SHARE = 0.001  # of the sphere; what shows less says nothing about where it was taken
FINEST_PX_PER_RAD = LARGEST_STEP * FINEST_ROWS / math.pi
"""Focal length, in pixels, beyond which nothing of a photo is lost when it is made smaller."""


def rig_on_sphere(rig: Rig, most_rows: int | None = None) -> tuple[Panorama, Pose]:
    """Return one panorama of all images, as if all had been taken from one place, and session_from_panorama.

    Its axes are those of the session, its place is the middle of the cameras; where images overlap, the one whose middle is nearest is
    shown. It has the rows of the finest image, or `most_rows`. For pictures, and for whatever needs no more.
    """
    cameras = [photo.camera for photo in rig.photos]
    rows = max(each.height_px if each.is_whole_sphere else _rows_of(each, FINEST_ROWS) for each in cameras)
    rows = rows if most_rows is None else min(rows, most_rows)
    only = rig.photos[0]
    if (
        len(cameras) == 1
        and only.camera.is_whole_sphere
        and np.allclose(rig.images[0].session_from_camera.rotation, np.eye(3))
    ):
        return Panorama(*resized_image(only.color, only.valid, (2 * rows, rows)), only.left_out), rig.session_from_rig
    sphere = SphereWindow.of_sphere(rows).grid()
    color, valid = np.zeros(sphere.shape, np.uint8), np.zeros(sphere.shape[:2], np.bool_)
    best = np.full(valid.shape, -2.0)
    for image in rig.images:
        directions = sphere @ image.session_from_camera.rotation
        found, seen = image_towards(image.photo, directions, rows)
        better = seen & (directions[..., 0] > best)
        color[better], valid[better], best[better] = found[better], True, directions[..., 0][better]
    return Panorama(color, valid, rig.left_out), rig.session_from_rig


def check_share(photo: Photo) -> None:
    """Raise PanoramaUnusableError where next to nothing of the sphere is visible in a photo, and OptionsError where most of it has no
    direction."""
    camera, sides = photo.camera, photo.valid.shape
    with_direction = share_with_direction(camera)
    if with_direction < _MIN_WITH_DIRECTION:
        raise OptionsError(
            "distortion: expected coefficients that are valid for most of the image, got some that fold over and "
            f"leave {with_direction:.0%} of it a direction; check their order and signs, and that the intrinsics "
            "belong to this image"
        )
    u, v, shown = project_to_image(camera, _directions())
    at = (np.clip(each.astype(np.int64), 0, side - 1) for each, side in zip((v, u), sides, strict=True))
    share = share_of_sphere(shown & photo.valid[tuple(at)])
    if share < _MIN_SHARE:
        raise PanoramaUnusableError(
            f"image: expected a photo that shows at least {_MIN_SHARE:.1%} of the sphere, got {share:.2%} "
            f"({camera.hfov_deg:.1f} degrees across); check the intrinsics and the mask"
        )
    # Last: of one that shows next to nothing of the sphere little is left when it is made smaller.
    if min(sides) < _MIN_SIDE:
        raise PanoramaUnusableError(
            f"image: expected a photo of at least {_MIN_SIDE} pixels a side, got {sides[1]} x {sides[0]}"
        )


def shown_share(rig: Rig) -> float:
    """Return about the share of the sphere, 0..1, that the images of a rig show together, overlaps counted once."""
    turned = (_directions() @ image.session_from_camera.rotation for image in rig.images)
    shown = [project_to_image(photo.camera, each)[2] for photo, each in zip(rig.photos, turned, strict=True)]
    return share_of_sphere(np.any(shown, axis=0))


def share_of_sphere(seen: NDArray[np.bool_]) -> float:
    """Return the share of the sphere, 0..1, that the true pixels (H, 2H) of an image of it cover."""
    row = np.arange(len(seen)) + 0.5
    return float((seen * np.sin(np.pi * row / len(seen))[:, None]).mean() * np.pi / 2)


def _rows_of(camera: Camera, most: int) -> int:
    """Return the rows, a power of two and `most` at most, of the sphere that is about as fine as the image of a camera."""
    exponent = round(math.log2(max(math.pi * min(camera.fx_px, camera.fy_px), _COARSEST_ROWS)))
    return min(1 << exponent, most)


@cache
def _directions() -> NDArray[np.float64]:
    """Return the directions of the pixels of the sphere on which extents are looked for; not to be written to."""
    found = SphereWindow.of_sphere(EXTENT_ROWS).grid()
    found.flags.writeable = False
    return found


@dataclass(frozen=True)
class PhotoOnWindow:
    """A photo on the window that it fills of a sphere: color (h, w, 3), seen (h, w); cone: half the opening angle around the optical axis
    that holds all of the photo, radians."""

    color: NDArray[np.uint8]
    seen: NDArray[np.bool_]
    window: SphereWindow
    cone: float


def photo_on_window(photo: Photo, max_rows: int, is_labels: bool) -> PhotoOnWindow:
    """Sample a photo on the window that it fills of a sphere of about its own resolution, `max_rows` at most."""
    rows = _rows_of(photo.camera, max_rows)
    if photo.camera.is_whole_sphere:
        sphere = SphereWindow.of_sphere(rows)
        return PhotoOnWindow(*resized_image(photo.color, photo.valid, (2 * rows, rows), is_labels), sphere, math.pi)
    shown = project_to_image(photo.camera, _directions())[2]
    window = _extent(shown).at(rows)
    ahead = _directions()[..., 0][shown]
    cone = math.pi if not len(ahead) else min(math.pi, math.acos(float(ahead.min())) + math.pi / EXTENT_ROWS)
    return PhotoOnWindow(*image_towards(photo, window.grid(), rows, is_labels), window, cone)


def _extent(shown: NDArray[np.bool_]) -> SphereWindow:
    """Return the window that a photo fills which shows those pixels of the sphere of `EXTENT_ROWS` rows, on the coarsest one."""
    fine = EXTENT_ROWS // _COARSEST_ROWS
    bounds = []
    for axis, most in ((1, _COARSEST_ROWS), (0, 2 * _COARSEST_ROWS)):
        used = np.flatnonzero(shown.any(axis))
        # One pixel of the search for the extent may hide an edge.
        first = max(0, (int(used.min()) - 1) // fine) if len(used) else 0
        last = min(most, (int(used.max()) + 1) // fine + 1) if len(used) else most
        bounds.append((first, last - first))
    (row, height), (column, width) = bounds
    return SphereWindow(_COARSEST_ROWS, row, column, height, width)
